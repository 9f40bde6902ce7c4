"""Does a TEST foretell what its sentence then does: its success, its facts, and how long it takes?

In physics, with pictures that are drawn and cameras that find tags in them. A run draws one of the scenes of
`benchmarks.skills`, and looks, small motions and stows between its sentences. Modules are displaced by errors whose two
sigma are what the cell states of them, the driver as in the skills and within what they state of it. Each sentence is
rehearsed, then performed. An axis of a pose is inside if the truth after the sentence is within the predicted spread of
the predicted fact.

    python -m tests.campaigns.foretold [--runs 100] [--only 7] [--processes 1] [--out FILE] [--exact]
    python -m tests.campaigns.foretold --join a.json b.json

`--exact`: exact arms without contact, and pictures as if by exact cameras: seconds instead of minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import random
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.copies import in_copies
from benchmarks.grasp import wilson
from benchmarks.report import finish, percentile, question
from benchmarks.skills import SCENES, _unsurveyed, offset
from broker.decisions import events
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.protocol.rehearsal import Rehearsal
from rtc.spatial import geometry
from rtc.world.model import World, initial_facts
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns import RESULTS
from tests.campaigns.against_truth import BEYOND_M, BEYOND_RAD
from tests.workers.eyes import Drawn, Ideal
from tests.workers.one_process import OneProcess
from workers.planning.robot_models import CellModel

SEED = 12
MODULES = ("MACS-NEW", "MACS-OLD")
TEST_S, LIMIT_S = 200.0, 900.0  # simulated
LOOKS = ("LOCATE MACS-NEW", "LOCATE MACS-OLD", "LOCATE POWER-DRIVER", "LOCATE BAY-2")
SENTENCES_OF_SCENES = {sentence for scene in SCENES.values() for sentence in scene.sentences}  # others need not succeed
MOVES = ("MOVE {arm} BY {cm} CM ALONG {axis}", "MOVE {arm} TO CLEAR-POINT-1", "STOW {arm}")
EXTRA = 0.5  # of the gaps between two sentences have one more
SHORT_S = 0.5  # of a sentence; a period of a job is a large part of it


@dataclass
class Foretold:
    """One sentence: what its TEST stated, and what became of it. Times in s."""

    run: int
    sentence: str
    feasible: bool
    done: bool
    cause: str = ""
    trims: int = 0
    predicted_s: float = 0.0
    measured_s: float = 0.0
    look_predicted_s: float = 0.0
    look_measured_s: float = 0.0
    open_end: bool = False  # it has a step that nothing but a limit ends
    touches: bool = False  # a step ends at a contact, so within the band of its search
    axes: dict[str, list[bool]] = field(default_factory=dict)  # fact -> for each axis whether the truth is inside
    over: dict[str, list[float]] = field(default_factory=dict)  # fact -> error of each axis over its spread


class Watched(OneProcess):
    """Keeps the reports of all primitives."""

    reports: list[Any]

    def _handle(self, event: events.Event) -> None:
        if isinstance(event, events.PrimitiveEnded):
            self.__dict__.setdefault("reports", []).append((event.subsystem, event.report))
        super()._handle(event)


def sentences(rng: random.Random) -> tuple[str, list[str]]:
    """(cell, sentences): those of one scene, with others between."""
    scene = SCENES[rng.choice([verb for verb, scene in SCENES.items() if not scene.opened])]
    given: list[str] = []
    for sentence in scene.sentences:
        if rng.random() < EXTRA:
            given.append(_extra(rng, sentence, looks=not given))
        given.append(sentence)
    return scene.cell, given


def _extra(rng: random.Random, before: str, *, looks: bool) -> str:
    if looks or rng.random() < 0.3:
        return rng.choice(LOOKS)
    arm = "LEFT-ARM" if "LEFT" in before else "RIGHT-ARM"
    return rng.choice(MOVES).format(arm=arm, cm=rng.randint(2, 8), axis=rng.choice(("X", "Y", "UP")))


def perform(number: int, exact: bool) -> list[Foretold]:
    rng = random.Random(f"{SEED}/{number}")
    name, given = sentences(rng)
    cell = _unsurveyed(Cell.load(name))
    sim: Any = KinematicCell(cell) if exact else BulletCell(cell)
    noise = np.random.default_rng([SEED, number])
    for module in MODULES:
        within = cell.object(module).known_within
        if within is not None:
            sim.displace(module, (0.5 * np.array(within.spread) * noise.normal(size=6)).tolist())
    if not exact:
        sim.displace("POWER-DRIVER", offset(number)) if name == "servicing" else None
        for _ in range(240):
            sim.step()
    eyes = Ideal(cell) if exact else Drawn(cell, seed=1000 * number)
    cluster = Watched(sim, CellModel(cell), World().overlay(initial_facts(cell)), eyes)
    found: list[Foretold] = []
    for sentence in given:
        found.append(one(cluster, sentence, number))
        if not found[-1].done and sentence in SENTENCES_OF_SCENES:
            break
    return found


def one(cluster: Watched, sentence: str, number: int) -> Foretold:
    tested = cluster.give(f"TEST {sentence}")
    cluster.run(TEST_S)
    rehearsal = cluster.outcomes[tested].rehearsal
    cluster.reports = []
    notes = len(cluster.notes)
    command = cluster.give(sentence)
    cluster.run(LIMIT_S)
    outcome = cluster.outcomes[command]
    made = Foretold(
        number,
        sentence,
        feasible=cluster.outcomes[tested].kind is OutcomeKind.SUCCEEDED,
        done=outcome.kind is OutcomeKind.SUCCEEDED,
        cause="" if outcome.kind is OutcomeKind.SUCCEEDED else _why(outcome, cluster.outcomes[tested]),
        trims=sum(bool(note.trim) for note in cluster.notes[notes:]),
    )
    if made.feasible and made.done and rehearsal is not None:
        _times(made, rehearsal, cluster.reports)
        _facts(made, rehearsal, cluster)
    return made


def _why(outcome: Outcome, tested: Outcome) -> str:
    why = outcome.refusal.message if outcome.refusal is not None else outcome.message
    return f"{outcome.kind.value}: {why}; its TEST {tested.kind.value}"


def _times(made: Foretold, rehearsal: Rehearsal, reports: list[Any]) -> None:
    looks = [report for subsystem, report in reports if report.sighting is not None or subsystem != "MCM"]
    made.look_measured_s = sum(report.duration_s for report in looks)
    made.measured_s = sum(report.duration_s for subsystem, report in reports if subsystem == "MCM")
    cameras = {report.performer for report in looks}
    for step in rehearsal.steps:
        if step.performer in cameras or "CAMERA" in step.performer:
            made.look_predicted_s += step.predicted_s
        else:
            made.predicted_s += step.predicted_s
        made.open_end = made.open_end or step.until_stopped
        made.touches = made.touches or step.reason == "contact"


def _facts(made: Foretold, rehearsal: Rehearsal, cluster: Watched) -> None:
    truth = cluster.sim.truth()
    for fact in rehearsal.changes:
        name, _, attribute = fact.key.rpartition(".")
        if fact.spread is None or fact.value is None or attribute not in ("frame", "grasp"):
            continue
        true = truth["poses"].get(name) or truth["seats"].get(name)
        if attribute == "grasp":
            holder = next((arm for arm, things in cluster.sim.held().items() if name in things), None)
            true = geometry.relative(truth["tcp"][holder], truth["poses"][name]) if holder else None
        if true is None:
            continue
        off = geometry.relative(fact.value, true)
        errors = [*off[:3].tolist(), *geometry.to_rpy(off).tolist()]
        room = [BEYOND_M] * 3 + [BEYOND_RAD] * 3
        made.axes[fact.key] = [abs(e) <= s + more for e, s, more in zip(errors, fact.spread, room, strict=True)]
        made.over[fact.key] = [abs(e) / (s + more) for e, s, more in zip(errors, fact.spread, room, strict=True)]


def metrics_of(rows: list[Foretold]) -> tuple[dict[str, float | None], list[tuple[str, str]]]:
    axes = [inside for row in rows for ones in row.axes.values() for inside in ones]
    feasible = [row for row in rows if row.feasible]
    refused = [row for row in rows if not row.feasible]
    plain = [r for r in feasible if r.done and not r.trims and not r.open_end and r.predicted_s > SHORT_S]
    known, touches = [r for r in plain if not r.touches], [r for r in plain if r.touches]
    looked = [row for row in feasible if row.done and row.look_measured_s and row.look_predicted_s]
    shown = [
        _share("axes of facts inside", sum(axes), len(axes)),
        _share("feasible ones done", sum(row.done for row in feasible), len(feasible)),
        _share("infeasible ones not done", sum(not row.done for row in refused), len(refused)),
        _off("durations without a touch", [row.measured_s / row.predicted_s - 1.0 for row in known]),
        _off("durations with a touch", [row.measured_s / row.predicted_s - 1.0 for row in touches]),
        _off("looks", [row.look_measured_s / row.look_predicted_s - 1.0 for row in looked]),
    ]
    for kind in sorted({key.rpartition(".")[2] + " after " + r.sentence.split()[0] for r in rows for key in r.axes}):
        attribute, _, verb = kind.partition(" after ")
        ones = [
            inside
            for row in rows
            if row.sentence.split()[0] == verb
            for key, found in row.axes.items()
            if key.endswith(attribute)
            for inside in found
        ]
        shown.append(_share(f"  {kind}", sum(ones), len(ones)))
    metrics: dict[str, float | None] = {
        "sentences": float(len(rows)),
        "inside": sum(axes) / max(1, len(axes)),
        "feasible_done": sum(row.done for row in feasible) / max(1, len(feasible)),
    }
    return metrics, shown


def _share(name: str, good: int, count: int) -> tuple[str, str]:
    low, high = wilson(good, count) if count else (math.nan, math.nan)
    return name, f"{good} of {count} ({100 * low:.1f} to {100 * high:.1f} %)"


def _off(name: str, shares: list[float]) -> tuple[str, str]:
    if not shares:
        return name, "none"
    low, mid, high = (100.0 * percentile(shares, q) for q in (5, 50, 95))
    most = 100.0 * max(shares, key=abs)
    return name, f"n {len(shares)}: p5 {low:+.1f}, p50 {mid:+.1f}, p95 {high:+.1f}, farthest {most:+.1f} %"


def _made(given: argparse.Namespace) -> Iterator[list[Foretold]]:
    numbers = given.only or range(given.seed_from, given.seed_from + given.runs)
    yield from in_copies(lambda number: perform(number, given.exact), numbers, given.processes)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=100)
    words.add_argument("--seed-from", type=int, default=0, help="number of the first run")
    words.add_argument("--only", type=int, nargs="+", help="these numbers alone")
    words.add_argument("--processes", type=int, default=1)
    words.add_argument("--exact", action="store_true", help="exact arms and cameras")
    words.add_argument("--out", type=Path, help="write the sentences into this file instead of the results")
    words.add_argument("--join", type=Path, nargs="+", help="report the sentences of these files")
    given = words.parse_args()
    question("foretold", "does a TEST foretell success, facts and times?", seed=SEED)
    rows: list[Foretold] = []
    if given.join:
        rows = [Foretold(**row) for file in given.join for row in json.loads(file.read_text())]
    else:
        for done in _made(given):
            rows += done
            for row in done:
                bad = [key for key, inside in row.axes.items() if not all(inside)]
                print(f"  {row.run} {row.sentence}: {row.cause or 'done'}{f'; outside: {bad}' * bool(bad)}", flush=True)
            if given.out:
                given.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    metrics, shown = metrics_of(rows)
    if given.out or given.only:
        print("\n".join(f"{name}: {value}" for name, value in shown))
    else:
        finish("foretold", metrics, shown, RESULTS)


if __name__ == "__main__":
    main()
