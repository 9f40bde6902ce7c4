"""How often does the swap-out end well without an operator when the modules are not where they are believed to be?

    python -m benchmarks.autonomy [--runs 200] [--seed-from 0] [--only 7 12] [--processes 1] [--out FILE] [--verbose]
    python -m benchmarks.autonomy --join a.json b.json ...

In physics, sentence by sentence in one process, without a broker: the lines of the swap-out up to the insertion.
Left out are the tests, HOLD, TRACK and their ABORT, which need a broker, and the lines of an operator. Both modules are
displaced with the seats that they are in, along and about all six axes. The errors are normally distributed: sigma 10
mm and 2 degrees, at most 30 mm and 5 degrees. The world knows both modules within the 35 mm and 5 degrees of the cell
file for what was not surveyed. A displacement is halved while the module overlaps another body. Run n always has the
same errors. Nothing that is displaced takes part in the stages of the door and of the bolts. So they are performed
once, and each run continues in a copy of that process.

A planner without a person follows advice: after a refusal or a failure it gives the advised sentences and the line
again, with the distance of AVOID-NEIGHBORS that is advised. Advice that only a person can follow, SET of a pose, is not
followed. So a run succeeds, or it surrenders. A surrender is clean if the arms rest, and the last answer has a cause
and an advice. After each sentence all valid facts are compared with the truth.

    success_rate          share of runs that reached the end of the last stage, by the truth too; with success_low/high
    first_time            runs in which no sentence was refused or failed
    wrong_beliefs         runs with a valid fact that is off by more than 5 mm or 2 deg beyond its spread
    unclean               runs that neither succeeded nor surrendered cleanly
    operator_offered      surrenders whose last advice names the operator
"""

from __future__ import annotations

import argparse
import json
import math
import random
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pybullet

from benchmarks.copies import in_copies
from benchmarks.grasp import wilson
from benchmarks.report import finish, question
from benchmarks.skills import rests
from examples.swapout import lines as demo_lines
from examples.swapout import swapout
from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from tests.campaigns import advice
from tests.campaigns.advice import Answer
from tests.campaigns.against_truth import judge
from tests.workers.conftest import Bench, Physical
from workers.planning.robot_models import CellModel

SEED = 24
SIGMA_M, SIGMA_RAD = 0.010, math.radians(2.0)
MOST_M, MOST_RAD = 0.030, math.radians(5.0)  # three sigma, within what the cell file states of modules not surveyed
MODULES = ("MACS-OLD", "MACS-NEW")
#: stage -> its lines
STAGES = {
    "door": ["C3", "C5", "C7"],
    "bolts": ["C6", "C10", "C11", "C12", "C14", "C15"],
    "extraction": ["C9", "C16", "C17"],
    "handoff": ["C19", "C20", "C21"],
    "insertion": ["C4", "C22", "C24", "C25", "C26", "C28", "C29"],
}
COMMON = ("door", "bolts")
SEATED = {"MACS-NEW": "BAY-2", "MACS-OLD": "RACK-2"}
SEATED_M, SEATED_RAD = 0.005, math.radians(2.0)


@dataclass
class AutonomyRun:
    """One swap-out with errors of both modules, and how it went."""

    number: int
    offsets: dict[str, list[float]]
    halved: int = 0
    reached: list[str] = field(default_factory=list)  # stages
    line: str = ""  # at which it surrendered
    cause: str = ""
    advice: str = ""
    failed: list[str] = field(default_factory=list)  # sentences that were refused or failed, with their cause
    trims: int = 0
    wrong: list[str] = field(default_factory=list)
    restless: str = ""
    unseated: str = ""  # at the end of a run whose sentences all succeeded
    simulated_s: float = 0.0
    seconds: float = 0.0

    @property
    def succeeded(self) -> bool:
        return len(self.reached) == len(STAGES) and not self.unseated

    @property
    def clean(self) -> bool:
        """Whether it succeeded or surrendered as it should."""
        return self.succeeded or bool(self.cause and self.advice and not self.restless and not self.unseated)

    def in_words(self) -> str:
        how = "succeeded" if self.succeeded else f"{self.line}: {self.cause} [{self.advice}] {self.unseated}"
        bad = [f"WRONG {one}" for one in self.wrong[:2]] + [f"RESTLESS {self.restless}"] * bool(self.restless)
        more = "".join(f"\n      {one}" for one in [*(f"failed {one}" for one in self.failed), *bad])
        return f"run {self.number}: {how}; {self.trims} trims, {self.seconds:.0f} s{more}"


def drawn(number: int) -> dict[str, list[float]]:
    """x y z (m), roll pitch yaw (rad) of each module in this run."""
    rng = random.Random(f"{SEED}/{number}")
    limits = [(SIGMA_M, MOST_M)] * 3 + [(SIGMA_RAD, MOST_RAD)] * 3
    return {module: [max(-most, min(most, rng.gauss(0.0, sigma))) for sigma, most in limits] for module in MODULES}


def _model() -> CellModel:
    """The cell `servicing`, in which no module was surveyed."""
    cell = Cell.load(swapout.CELL)
    within = cell.object("MACS-NEW").known_within
    objects = [
        msgspec.structs.replace(one, known_within=within) if one.name in MODULES else one for one in cell.objects
    ]
    return CellModel(msgspec.structs.replace(cell, objects=objects))


class Trial:
    """The simulated cell of one run."""

    def __init__(self, run: AutonomyRun, *, verbose: bool) -> None:
        self.run, self.verbose = run, verbose
        self.model = _model()
        self.subsystem = Physical(self.model.cell)
        self.sim = self.subsystem.sim
        self.bench = Bench(self.subsystem, self.model)
        self.bench.unsurveyed()

    def displace(self) -> None:
        for module in MODULES:
            self._displace(module)

    def _displace(self, module: str) -> None:
        """Displace it with its seat; half as far while it overlaps another body, which would push it out."""
        before, offset = self.truth()["poses"][module], self.run.offsets[module]
        self.subsystem.displace_and_turn(module, offset)
        while self._overlaps(module):
            self.run.halved += 1
            self._put_back(module, before)
            offset[:] = [0.5 * part for part in offset]
            self.subsystem.displace_and_turn(module, offset)

    def _put_back(self, module: str, pose: Sequence[float]) -> None:
        world, seat = self.sim.world, self.model.cell.object(module).seat
        world.place(world.objects[module], np.array(pose))
        along = world.seats[seat]
        along.home = np.array(self.model.cell.seat(seat).frame.pose)
        world.place(along, along.home)

    def _overlaps(self, module: str) -> bool:
        """Whether it is inside a body other than its seat."""
        world = self.sim.world
        seat = world.seats[self.model.cell.object(module).seat]
        thing = world.objects[module]
        others = [body for body in (*world.objects.values(), *world.seats.values()) if body not in (thing, seat)]
        return any(
            pybullet.getClosestPoints(a, b, 0.0, physicsClientId=world.client)
            for a, _ in thing.parts
            for other in others
            for b, _ in other.parts
        )

    def truth(self) -> dict[str, Any]:
        return self.subsystem.truth()

    def perform(self, stages: Iterable[str]) -> bool:
        """Whether all lines of these stages succeed."""
        every = {line.label: line.text for line in demo_lines.read(swapout.LINES.read_text())}
        for stage in stages:
            for label in STAGES[stage]:
                if not self._done(label, every[label]):
                    return False
            self.run.reached.append(stage)
        return True

    def _done(self, label: str, text: str) -> bool:
        """Whether a line succeeds, at last by its advice; else the run surrenders at it."""
        last = self._say(text)
        if not last.succeeded:
            last = self._follow(text, last)
        if not last.succeeded:
            self.run.line, self.run.cause, self.run.advice = label, last.message, in_one_line(last.clears)
        return last.succeeded

    def _follow(self, text: str, answer: Answer) -> Answer:
        last = answer

        def say(sentence: str) -> Answer:
            nonlocal last
            if sentence.startswith("SET "):
                return Answer(False, "only a person who looks can state a pose")
            last = self._say(sentence)
            return last

        followed = advice.follow(say, text, answer, self.truth)
        return last if followed.end == "reached" or last.succeeded is False else answer

    def _say(self, text: str) -> Answer:
        began_s = time.process_time()
        run, done = self.run, self.bench.do(text)
        run.trims += len(done.trims)
        answer = Answer.of(done)
        if not answer.succeeded:
            run.failed.append(f"{text}: {answer}")
            if not rests(self.subsystem):
                run.restless = text
        found = judge(self.bench.world.facts.values(), self.truth())
        run.wrong += [f"after {text}: {one}" for one in found.wrong]
        run.simulated_s += sum(report.duration_s for report in done.reports)
        if self.verbose:
            print(f"    {time.process_time() - began_s:5.1f} s  {text[:60]}: {str(answer)[:200]}", flush=True)
        return answer

    def check_seated(self) -> None:
        truth = self.truth()
        for module, seat in SEATED.items():
            place = geometry.compose(truth["seats"][seat], self.model.cell.seat(seat).module_frame.pose)
            off_m = geometry.distance(truth["poses"][module], place)
            off_rad = geometry.angle(truth["poses"][module], place)
            if off_m > SEATED_M or off_rad > SEATED_RAD:
                what = f"{module} {1e3 * off_m:.1f} mm, {math.degrees(off_rad):.1f} deg from {seat}"
                self.run.unseated = f"{self.run.unseated} {what}".strip()


prepared: Trial | None = None  # with the door open and the bolts loose; each run begins with a copy of it


def prepare(*, verbose: bool) -> None:
    """Perform what no displacement changes. Raises RuntimeError if it fails."""
    global prepared
    prepared = Trial(AutonomyRun(-1, {}), verbose=verbose)
    if not prepared.perform(COMMON):
        raise RuntimeError(prepared.run.in_words())
    prepared.subsystem.close_eyes()  # each copy opens its own


def perform(number: int) -> AutonomyRun:
    """One run, in a process that is a copy of the prepared one and ends with the run."""
    assert prepared is not None
    began_s, trial = time.process_time(), prepared
    trial.run = run = AutonomyRun(number, drawn(number), reached=list(COMMON), trims=trial.run.trims)
    trial.displace()
    if trial.perform(stage for stage in STAGES if stage not in COMMON):
        trial.check_seated()
    trial.subsystem.close()
    run.seconds = time.process_time() - began_s
    return run


def metrics_of(done: Sequence[AutonomyRun]) -> tuple[dict[str, float | None], list[tuple[str, str]]]:
    """The metrics, and the rows: stages reached, rate with its Wilson interval of 95 %, causes."""
    successes = sum(run.succeeded for run in done)
    low, high = wilson(successes, len(done))
    surrendered = [run for run in done if not run.succeeded]
    rows = [(f"reached: {stage}", f"{sum(stage in run.reached for run in done)} of {len(done)}") for stage in STAGES]
    rows.append(("succeeded", f"{successes} of {len(done)} (Wilson {low:.0%} to {high:.0%})"))
    causes = Counter(f"{run.line}: {(run.cause or run.unseated)[:110]}" for run in surrendered)
    rows += [(f"surrendered, {count} x", cause) for cause, count in causes.most_common()]
    metrics: dict[str, float | None] = {
        "runs": float(len(done)),
        "success_rate": successes / len(done) if done else None,
        "success_low": round(low, 4),
        "success_high": round(high, 4),
        "first_time": float(sum(not run.failed for run in done)),
        "wrong_beliefs": float(sum(bool(run.wrong) for run in done)),
        "unclean": float(sum(not run.clean for run in done)),
        "operator_offered": float(sum("OPERATOR" in run.advice for run in surrendered)),
        "halved": float(sum(bool(run.halved) for run in done)),
        "seconds_per_run": sum(run.seconds for run in done) / len(done) if done else None,
    }
    return metrics, rows


def _joined(files: Iterable[Path]) -> list[AutonomyRun]:
    rows = [row for file in files for row in json.loads(file.read_text())]
    return list({row["number"]: AutonomyRun(**row) for row in rows}.values())


def _made(given: argparse.Namespace) -> list[AutonomyRun]:
    prepare(verbose=given.verbose)
    done = []
    for run in in_copies(perform, given.only or range(given.seed_from, given.seed_from + given.runs), given.processes):
        done.append(run)
        print(f"  {run.in_words()}", flush=True)
        if given.out:  # after each run: a series that is ended early keeps its results
            given.out.write_text(json.dumps([asdict(run) for run in done]))
    return done


def main() -> None:
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.autonomy", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words.add_argument("--runs", type=int, default=200)
    words.add_argument("--seed-from", type=int, default=0, help="number of the first run")
    words.add_argument("--only", type=int, nargs="+", help="these runs alone")
    words.add_argument("--processes", type=int, default=1)
    words.add_argument("--verbose", action="store_true", help="show each sentence")
    words.add_argument("--out", type=Path, help="write the runs into this file instead of the results")
    words.add_argument("--join", type=Path, nargs="+", help="report the runs of these files")
    given = words.parse_args()
    question(
        "autonomy", "how often does the swap-out succeed without an operator, with errors of the poses?", seed=SEED
    )
    done = _joined(given.join) if given.join else _made(given)
    metrics, rows = metrics_of(done)
    if given.join or not (given.out or given.only):
        shown = [(name, "-" if value is None else f"{value:.4g}") for name, value in metrics.items()]
        finish("autonomy", metrics, rows + shown, data=[asdict(run) for run in done])
    else:
        print(json.dumps({**metrics, **dict(rows)}))


if __name__ == "__main__":
    main()
