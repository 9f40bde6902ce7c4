"""How often does each verb succeed in physics when things are not where they are believed to be?

    python -m benchmarks.skills [--runs 100] [--seed-from 0] [--only 7 12] [--verb EXTRACT ...] [--touch-only]
                                [--processes 1] [--out FILE]
    python -m benchmarks.skills --join a.json b.json ...

In physics, sentence by sentence in one process, without a broker. A run displaces a thing with the seat it is in,
prepares a scene with sentences, and gives the sentence of the verb. The errors are normally distributed about all six
axes: sigma 5 mm and 1 degree; at most three sigma. Run n has the same errors for every verb. The world knows a module
within the 35 mm and 5 degrees of the cell file, and the driver within 15 mm and 3 degrees.
After each sentence all valid facts are compared with the truth, and the arms must rest. After a refusal or a failure
the first advised sentence is given, then the sentence again. Verbs with the same first sentences share them: these are
performed once, and each verb continues in a copy of that process. If one of them fails, each verb behind it fails
there.

    lowest_rate           share of successes of the verb with the fewest
    wrong_valid_facts     valid facts that are off by more than 5 mm or 2 deg beyond their spread
    restless              arms that moved after the sentence
    repaired_rate         share of refusals and failures whose first advised sentence cleared them
"""

from __future__ import annotations

import argparse
import json
import math
import random
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.copies import in_copies
from benchmarks.grasp import REST_RAD, REST_TICKS, wilson
from benchmarks.report import finish, question
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import KnownWithin
from tests.campaigns import advice, door
from tests.campaigns.advice import Answer
from tests.campaigns.against_truth import judge
from tests.workers.conftest import Bench, Physical, Run
from workers.planning.robot_models import CellModel

SEED = 11
SIGMA_M, SIGMA_RAD = 0.005, math.radians(1.0)
MOST_SIGMAS = 3.0
DRIVER_M = 0.0149  # three sigma, but less than the 15 mm at which GRASP without a camera is refused


class Scene(NamedTuple):
    """How a verb is tried: the cell, the thing that is displaced in it, the sentences; the last one is of the verb."""

    cell: str
    displaced: str
    sentences: list[str]
    opened: bool = False  # the door stands open from the beginning

    @property
    def root(self) -> tuple[str, str, bool]:
        """What scenes must have in common to share their first sentences."""
        return self.cell, self.displaced, self.opened


GRASPED = ["GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"]
HELD = [*GRASPED, "EXTRACT MACS-NEW FROM RACK-1 WITH RIGHT-ARM"]
ALIGNED = [*HELD, "CARRY MACS-NEW TO BAY-2 WITH RIGHT-ARM", "ALIGN MACS-NEW TO BAY-2 WITH RIGHT-ARM"]
AT_DOOR = ["GRASP LEFT-END-EFF DOOR-2 LATCH-PULL"]
OPENED = [*AT_DOOR, "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM"]
DRIVER = ["GRASP RIGHT-END-EFF POWER-DRIVER TOOL-GRIP"]
LOOSENED = [*DRIVER, "LOOSEN BOLT-1 BY 8 TURNS WITH RIGHT-ARM"]
HANDOFF = "HANDOFF MACS-NEW FROM RIGHT-ARM TO LEFT-ARM"


def of_module(before: list[str], sentence: str) -> Scene:
    return Scene("swapout", "MACS-NEW", [*before, sentence])


def of_door(before: list[str], sentence: str) -> Scene:
    return Scene("servicing", door.DOOR, [*before, sentence])


def of_bolt(before: list[str], sentence: str) -> Scene:
    """The driver is displaced on its rack. The bolt is where the cell states it."""
    return Scene("servicing", "POWER-DRIVER", [*before, sentence], opened=True)


#: verb -> its scene
SCENES = {
    "GRASP": of_module([], GRASPED[0]),
    "LIFT": of_module(GRASPED, "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"),
    "EXTRACT": of_module(GRASPED, HELD[-1]),
    "RELEASE": of_module(GRASPED, "RELEASE MACS-NEW WITH RIGHT-ARM"),
    "PLACE": of_module(HELD, "PLACE MACS-NEW ON BAY-2 WITH RIGHT-ARM"),
    "INSERT": of_module(HELD, "INSERT MACS-NEW INTO BAY-2 WITH RIGHT-ARM"),
    "CARRY": of_module(HELD, ALIGNED[2]),
    "CARRY BOTH-ARMS": of_module(HELD, "CARRY MACS-NEW TO BAY-2-FRONT WITH BOTH-ARMS"),
    "HANDOFF": of_module(HELD, HANDOFF),
    "ALIGN": of_module(ALIGNED[:-1], ALIGNED[-1]),
    "PULL": of_module(ALIGNED, "PULL MACS-NEW BY 3 CM WITH RIGHT-ARM"),
    "PUSH": of_module(ALIGNED, "PUSH MACS-NEW BY 2 CM WITH RIGHT-ARM"),
    "OPEN": of_door(AT_DOOR, OPENED[-1]),
    "CLOSE": of_door(OPENED, "CLOSE DOOR-2 WITH LEFT-ARM"),
    "LOOSEN": of_bolt(DRIVER, LOOSENED[-1]),
    "VERIFY": of_bolt(LOOSENED, "VERIFY BOLT-1 AT LOOSE"),
    "TIGHTEN": of_bolt(LOOSENED, "TIGHTEN BOLT-1 UNTIL TORQUE EXCEEDS 3.4 NM WITH RIGHT-ARM"),
}


@dataclass
class SkillRun:
    """One verb with the errors of one number, and how it went."""

    verb: str
    number: int
    offset: list[float]
    succeeded: bool = False
    stage: str = ""  # the sentence that failed
    cause: str = ""
    repaired: bool | None = None  # after the first advised sentence; None: nothing failed
    trims: int = 0
    wrong: list[str] = field(default_factory=list)
    restless: bool = False
    simulated_s: float = 0.0  # with the sentences before
    seconds: float = 0.0  # processor time of its last sentence

    def in_words(self) -> str:
        how = "succeeded" if self.succeeded else f"{self.stage}: {self.cause}"
        bad = "".join(f"\n      WRONG {one}" for one in self.wrong) + "\n      RESTLESS" * self.restless
        return f"{self.verb} {self.number}: {how}; {self.trims} trims, {self.seconds:.1f} s{bad}"


def offset(number: int) -> list[float]:
    """x y z (m), roll pitch yaw (rad) of this run."""
    rng = random.Random(f"{SEED}/{number}")
    drawn = [max(-MOST_SIGMAS, min(MOST_SIGMAS, rng.gauss(0.0, 1.0))) for _ in range(6)]
    return [share * (SIGMA_M if axis < 3 else SIGMA_RAD) for axis, share in enumerate(drawn)]


class Trial:
    """The simulated cell of a run, from the common beginning of several scenes."""

    physical: type[Physical] = Physical
    scenes: Mapping[str, Scene] = SCENES

    def __init__(self, scene: Scene, *, cameras: bool) -> None:
        self.displaced = scene.displaced
        self.run = SkillRun("", -1, [])
        cell = _unsurveyed(Cell.load(scene.cell))
        self.model = CellModel(cell if cameras else msgspec.structs.replace(cell, cameras=[]))
        self.subsystem = self.physical(self.model.cell)
        self.bench = Bench(self.subsystem, self.model)
        self.bench.unsurveyed()
        self.sim = self.subsystem.sim
        if scene.opened:
            door.stand_open(self.bench)

    def perform(self, verbs: Sequence[str], number: int) -> list[SkillRun]:
        """The runs of this number of verbs whose scenes begin here. This process can make no other run after it."""
        self.run = SkillRun("", number, offset(number))
        self._displace()
        return self._branch(verbs, 0)

    def _branch(self, verbs: Sequence[str], depth: int) -> list[SkillRun]:
        """The runs of verbs whose first `depth` sentences were performed: a copy for each next sentence."""
        self.subsystem.close_eyes()  # each copy opens its own
        behind = [(sentence, ones, depth) for sentence, ones in by_next_sentence(verbs, depth, self.scenes).items()]
        return [run for runs in in_copies(self._continue, behind) for run in runs]

    def _continue(self, way: tuple[str, list[str], int]) -> list[SkillRun]:
        sentence, verbs, depth = way
        began_s, before = time.process_time(), self.run
        last = [verb for verb in verbs if len(self.scenes[verb].sentences) == depth + 1]
        behind = [verb for verb in verbs if verb not in last]
        self.run = replace(before, wrong=list(before.wrong))
        succeeded = self._done(sentence)
        self.run.seconds = time.process_time() - began_s
        runs = [replace(self.run, verb=verb, succeeded=succeeded) for verb in last]
        if succeeded or self.run.repaired:
            return runs + (self._branch(behind, depth + 1) if behind else [])
        return runs + [replace(self.run, verb=verb) for verb in behind]

    def _displace(self) -> None:
        if self.displaced == door.DOOR:
            door.displace(self.sim, self.run.offset)
        else:
            self.subsystem.displace_and_turn(self.displaced, list(self.run.offset))

    def _done(self, sentence: str) -> bool:
        """Whether it succeeds by itself; notes its failure, and whether the advice repaired it, and judges after it."""
        run = self.run
        done = self._do(sentence)
        if not done.succeeded:
            run.stage, run.cause = sentence, str(Answer.of(done))
            run.repaired = self._repaired(sentence, done)
        if self.displaced != door.DOOR:  # with a door the satellite is displaced, which the cell states exactly
            found = judge(self.bench.world.facts.values(), self._truth())
            run.wrong += [f"after {sentence}: {one}" for one in found.wrong]
        run.restless = run.restless or not rests(self.subsystem)
        return done.succeeded

    def _do(self, sentence: str) -> Run:
        done = self.bench.do(sentence)
        self.run.trims += len(done.trims)
        self.run.simulated_s += sum(report.duration_s for report in done.reports)
        return done

    def _repaired(self, sentence: str, done: Run) -> bool:
        """Whether the first sentence of the advice, and then the sentence again, succeed."""
        advised = advice.first(Answer.of(done).clears, sentence, self._truth)[:1]
        return any(self._do(one).succeeded for one in advised) and (
            advised == [sentence] or self._do(sentence).succeeded
        )

    def _truth(self) -> dict[str, Any]:
        return self.subsystem.truth()


def rests(subsystem: Physical) -> bool:
    """Whether all arms stand still for the next `REST_TICKS`."""
    arms = subsystem.sim.arms
    before = {name: arm.read().joints for name, arm in arms.items()}
    for _ in range(REST_TICKS):
        subsystem.tick()
    return all(
        abs(now - then) < REST_RAD
        for name, arm in arms.items()
        for now, then in zip(arm.read().joints, before[name], strict=True)
    )


def _unsurveyed(cell: Cell) -> Cell:
    """The cell, if its driver is known as well as these errors allow; a cell file may state it as surveyed."""
    driver = KnownWithin(xyz_m=[DRIVER_M] * 3, rpy_deg=[math.degrees(MOST_SIGMAS * SIGMA_RAD)] * 3)
    objects = [
        msgspec.structs.replace(thing, known_within=driver) if thing.name == "POWER-DRIVER" else thing
        for thing in cell.objects
    ]
    return msgspec.structs.replace(cell, objects=objects)


def by_next_sentence(verbs: Iterable[str], depth: int, scenes: Mapping[str, Scene] = SCENES) -> dict[str, list[str]]:
    """Verbs by the sentence that follows the first `depth` ones of their scenes."""
    found: dict[str, list[str]] = {}
    for verb in verbs:
        found.setdefault(scenes[verb].sentences[depth], []).append(verb)
    return found


prepared: list[tuple[Trial, list[str]]] = []  # one for each common beginning, with its verbs; runs continue in copies


def prepare(verbs: Sequence[str], *, cameras: bool) -> None:
    roots: dict[tuple[str, str, bool], list[str]] = {}
    for verb in verbs:
        roots.setdefault(SCENES[verb].root, []).append(verb)
    prepared[:] = [(Trial(SCENES[ones[0]], cameras=cameras), ones) for ones in roots.values()]


def perform(number: int) -> list[SkillRun]:
    """The runs of this number, in a copy of the prepared process."""
    done = [run for trial, verbs in prepared for run in trial.perform(verbs, number)]
    return sorted(done, key=lambda run: list(SCENES).index(run.verb))


def metrics_of(done: list[SkillRun]) -> tuple[dict[str, float | None], list[tuple[str, str]]]:
    """The metrics, and a row for each verb: its rate with the Wilson interval of 95 %, and the causes of failures."""
    rows, rates = [], []
    for verb in dict.fromkeys(run.verb for run in done):
        ones = [run for run in done if run.verb == verb]
        successes = sum(run.succeeded for run in ones)
        low, high = wilson(successes, len(ones))
        rates.append(successes / len(ones))
        causes = Counter(f"{run.stage}: {run.cause[:90]}" for run in ones if not run.succeeded)
        words = "".join(f"; {count} x {cause}" for cause, count in causes.most_common(3))
        rows.append((verb, f"{successes} of {len(ones)} ({low:.0%} to {high:.0%}){words}"))
    failed = [run for run in done if run.repaired is not None]
    metrics = {
        "verbs": float(len(rows)),
        "runs": float(len(done)),
        "lowest_rate": min(rates, default=None),
        "wrong_valid_facts": float(sum(len(run.wrong) for run in done)),
        "restless": float(sum(run.restless for run in done)),
        "repaired_rate": sum(bool(run.repaired) for run in failed) / len(failed) if failed else None,
    }
    return metrics, rows


def joined(files: Iterable[Path]) -> list[SkillRun]:
    """The runs of several files; of the same verb and number the last one."""
    rows = [row for file in files for row in json.loads(file.read_text())]
    return list({(row["verb"], row["number"]): SkillRun(**row) for row in rows}.values())


def _made(given: argparse.Namespace) -> list[SkillRun]:
    prepare(given.verb or list(SCENES), cameras=not given.touch_only)
    done: list[SkillRun] = []
    numbers = given.only or range(given.seed_from, given.seed_from + given.runs)
    for runs in in_copies(perform, numbers, given.processes):
        done += runs
        print("\n".join(run.in_words() for run in runs), flush=True)
        if given.out:  # after each number: a series that is ended early keeps its results
            given.out.write_text(json.dumps([asdict(run) for run in done], indent=1))
    return done


def main() -> None:
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.skills", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words.add_argument("--runs", type=int, default=100, help="runs of each verb")
    words.add_argument("--seed-from", type=int, default=0, help="number of the first run")
    words.add_argument("--only", type=int, nargs="+", help="these numbers alone")
    words.add_argument("--verb", nargs="+", choices=SCENES, help="these alone")
    words.add_argument("--touch-only", action="store_true", help="without cameras")
    words.add_argument("--processes", type=int, default=1)
    words.add_argument("--out", type=Path, help="write the runs into this file instead of the results")
    words.add_argument("--join", type=Path, nargs="+", help="report the runs of these files")
    given = words.parse_args()
    question("skills", "how often does each verb succeed with pose errors of 5 mm and 1 degree?", seed=SEED)
    done = joined(given.join) if given.join else _made(given)
    metrics, rows = metrics_of(done)
    if given.join or not (given.out or given.only):
        shown = [(name, "-" if value is None else f"{value:.4g}") for name, value in metrics.items()]
        finish("skills", metrics, rows + shown, data=[asdict(run) for run in done])
    else:
        print(json.dumps({**metrics, **dict(rows)}))


if __name__ == "__main__":
    main()
