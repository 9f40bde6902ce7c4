"""Does the advice lead out after every halt, within four sentences?

A sentence is halted in a drawn motion, at a drawn share of its path: carries with one arm and with both, level ways,
lifts, doors beside a displaced satellite. What a hand holds then lies up to 2 mm and 1 degree off, as after a swing.
The advice is followed literally (`tests.campaigns.advice`). A run is done if the sentence, or what is left of it,
succeeds; its arm is free if an advised motion of it succeeds. In half of the runs another sentence is given after the
stop, often one that cannot be done: what is advised instead of it must be done then. In a quarter of these the cell has
no cameras, and in a third the stop is a touch or an overload, after which the pose in the hand is badly known. More
than four sentences, the same advice twice, or advice without a sentence is stuck. No physics: the arm follows its
trajectory (`Reporter`), which takes seconds per run where `tests.campaigns.stops` takes minutes; what touches and slips
is tried there.

    python -m tests.campaigns.after_stops [--runs 300] [--from 0] [--only 17]
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from functools import cache
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from benchmarks.grasp import wilson
from benchmarks.report import question
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import BoundStep, EndReport, MoveStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import JointTrajectory, Primitive
from rtc.spatial import geometry
from rtc.world.model import World
from tests.campaigns import advice, numbered_runs
from tests.campaigns.advice import Answer
from tests.workers.conftest import MODEL, Bench, Reporter
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

SEED = 41
ATTEMPTS = 60  # sentences that are refused, or end before the halt, are drawn anew
OFF_M, OFF_RAD = 0.002, math.radians(1.0)
DISPLACED_M, DISPLACED_RAD = 0.010, math.radians(1.0)  # of the satellite with its door
SHARES = (0.1, 0.15, 0.4, 0.2, 0.07, 0.08)  # of the starts
MOTIONS = ("STOW", "RETRACT", "MOVE", "LIFT", "CARRY", "PLACE", "HANDOFF", "OPEN", "CLOSE")

ARMS = {"RIGHT-ARM": ("MACS-NEW", "HANDLE-A", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "HANDLE-B", "RACK-2")}
LEVEL = " MAINTAIN POSE-DURING-MOTION LEVEL"
GRASP, LIFT = "GRASP {module} {handle} WITH {arm}", "LIFT {module} BY 20 CM WITH {arm}"
BOTH = "CARRY {module} TO BAY-2-FRONT WITH BOTH-ARMS"
#: start -> (cell, sentences that lead there, sentences to be halted)
STARTS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "home": ("swapout", (), (GRASP, GRASP + LEVEL, "APPROACH {module} AT {handle} WITH {arm}", "STOW {arm}")),
    "seated": (
        "swapout",
        (GRASP,),
        (
            *(LIFT, "EXTRACT {module} FROM {rack}", "CARRY {module} TO CLEAR-POINT-1"),
            *("RELEASE {module} WITH {arm}", "CARRY {module} TO BAY-2-FRONT WITH BOTH-ARMS"),
        ),
    ),
    "lifted": (
        "swapout",
        (GRASP, LIFT),
        (
            *("CARRY {module} TO CLEAR-POINT-1" + end for end in ("", LEVEL, " STRAIGHT-LINE")),
            *(f"CARRY {{module}} TO {place} WITH BOTH-ARMS{LEVEL}" for place in ("BAY-2-FRONT", "CLEAR-POINT-1")),
            *(BOTH, "CARRY {module} TO BAY-2 WITH {arm}" + LEVEL, "HANDOFF {module} FROM {arm} TO {other}"),
            *("PLACE {module} ON {rack} WITH {arm}", "INSERT {module} INTO BAY-2 WITH {arm}"),
            *("LIFT {module} BY {cm} CM WITH {arm}", "MOVE {arm} BY {cm} CM ALONG {axis}" + LEVEL, "STOW {arm}"),
        ),
    ),
    "both": (
        "swapout",
        (GRASP, LIFT, BOTH),
        (
            *("CARRY {module} TO CLEAR-POINT-1 WITH BOTH-ARMS" + end for end in ("", LEVEL)),
            *("MOVE BOTH-ARMS BY {cm} CM ALONG {axis}" + LEVEL, "LIFT {module} BY {cm} CM WITH BOTH-ARMS"),
            "HANDOFF {module} FROM {arm} TO {other}",
        ),
    ),
    "door": (
        "servicing",
        ("GRASP DOOR-2 LATCH-PULL WITH LEFT-ARM",),
        ("OPEN DOOR-2 BY {deg} DEG WITH LEFT-ARM", "OPEN DOOR-2 TO {deg} DEG WITH LEFT-ARM"),
    ),
    "open door": (
        "servicing",
        ("GRASP DOOR-2 LATCH-PULL WITH LEFT-ARM", "OPEN DOOR-2 TO 80 DEG WITH LEFT-ARM"),
        ("CLOSE DOOR-2 BY {deg} DEG WITH LEFT-ARM", "OPEN DOOR-2 BY 20 DEG WITH LEFT-ARM", "CLOSE DOOR-2"),
    ),
}
STOPS = (*[StopReason.HALT] * 4, StopReason.CONTACT, StopReason.FORCE_LIMIT)
FORCE = {"trip_wrench": [5.0, 3.0, -30.0, 0.1, 0.2, 0.0], "measured": 31.0, "limit": 30.0}  # of a touch
_TO = (
    "{place}",
    "{place} STRAIGHT-LINE",
    "{place}" + LEVEL,
    "{place} WITH BOTH-ARMS",
    "{place} WITH BOTH-ARMS" + LEVEL,
)
#: sentences after the stop, by the cell: with seats that are taken, places out of reach, and ways that are too far
LATER = {
    "swapout": (
        *(f"CARRY {{module}} TO {to}" for to in _TO),
        *("CARRY {module} TO {seat} WITH {arm}", "PLACE {module} ON {seat} WITH {arm}", "INSERT {module} INTO {seat}"),
        *("ALIGN {module} TO {seat}", "HANDOFF {module} FROM {arm} TO {other}", "EXTRACT {module} FROM {rack}"),
        *("LIFT {module} BY {far} CM WITH {arm}", "MOVE {arm} BY {far} CM ALONG {axis}", "RETRACT {arm} BY 60 CM"),
        *(
            "MOVE {arm} TO {place}",
            "MOVE {arm} TO {place} STRAIGHT-LINE" + LEVEL,
            "MOVE BOTH-ARMS BY {cm} CM ALONG {axis}",
        ),
        *("GRASP {module} WITH {other}", "GRASP {neighbour} WITH {arm}", "RELEASE {module}", "OPEN {arm}"),
        *("STOW {arm}", "STOW {other}", "RETRACT {arm}", "VERIFY {module} AT {rack}", "LOCATE {module}"),
    ),
    "servicing": (
        *(
            "OPEN DOOR-2 BY {deg} DEG WITH LEFT-ARM",
            "OPEN DOOR-2 BY 300 DEG",
            "CLOSE DOOR-2 BY {deg} DEG",
            "CLOSE DOOR-2",
        ),
        *("RELEASE DOOR-2", "STOW LEFT-ARM", "RETRACT LEFT-ARM", "MOVE LEFT-ARM TO {place}", "LOCATE BOLT-1"),
        *("PUSH DOOR-2 BY 5 CM", "PULL DOOR-2 BY 5 CM", "MOVE LEFT-ARM BY {far} CM ALONG {axis}"),
    ),
}


class Halting(Reporter):
    """Stops one motion of an arm on its way. It feels what its arm knows nothing of: the front and the end of a bar."""

    motions = 0  # that are left until the one that is halted; 0: none
    share = 1.0
    stop = StopReason.HALT
    bench: Bench  # whose world states where a bar is believed to be

    def perform(self, made: Primitive, bound: BoundStep) -> EndReport:
        if isinstance(made.trajectory, JointTrajectory):
            self.motions -= 1
            if self.motions == 0:
                return self._halted(made, bound)
        return super().perform(made, bound)

    def _move(self, arm: str, way: JointTrajectory, made: Primitive, bound: BoundStep) -> StopReason:
        reason = super()._move(arm, way, made, bound)
        assert bound.evaluation is not None
        step = bound.evaluation.step
        feels = reason is StopReason.GOAL and step.expect == [StopReason.CONTACT]
        beyond_m = step.beyond_m if feels and isinstance(step, MoveStep) else None
        return reason if beyond_m is None else self._felt(arm, way, bound, beyond_m)

    def _felt(self, arm: str, way: JointTrajectory, bound: BoundStep, beyond_m: float) -> StopReason:
        """The touch of a search that ends `beyond_m` behind where it would be: as much sooner or later as the object is
        nearer or farther along the way."""
        assert bound.evaluation is not None
        name = bound.evaluation.context.object
        off = self.poses[name][:3] - WorldQuery(self.bench.model, self.bench.world).frame(name)[:3]
        places = [MODEL.arms[arm].fk(np.array(joints))[:3] for joints in way.positions]
        along = (places[-1] - places[0]) / max(1e-9, float(np.linalg.norm(places[-1] - places[0])))
        at_m = float((places[-1] - places[0] + off) @ along) - beyond_m
        touching = (n for n, place in enumerate(places) if float((place - places[0]) @ along) >= at_m)
        if (first := next(touching, None)) is None:
            return StopReason.GOAL
        self.joints[arm] = np.array(way.positions[first])
        return StopReason.CONTACT

    def _halted(self, made: Primitive, bound: BoundStep) -> EndReport:
        assert bound.evaluation is not None
        arm, partner = made.performer, None
        before = MODEL.arms[arm].fk(self.joints[arm])
        for name in [arm] if made.partner is None else [arm, made.partner.performer]:
            positions = made.paths[name].positions
            self.joints[name] = np.array(positions[round(self.share * (len(positions) - 1))])
        if held := bound.evaluation.held:
            in_hand = geometry.relative(before, self.poses[held])
            self.poses[held] = geometry.compose(MODEL.arms[arm].fk(self.joints[arm]), in_hand)
        if made.partner is not None:
            partner = self._report(made, made.partner.performer, self.stop, bound)
        force = FORCE if self.stop is not StopReason.HALT else {}
        return msgspec.structs.replace(self._report(made, arm, self.stop, bound), partner=partner, **force)


class Drawn(NamedTuple):
    start: str
    arm: str
    sentence: str
    motion: int  # that is halted, from 1
    share: float  # of its path
    later: str = ""  # the sentence that is given then; empty: the same again
    stop: StopReason = StopReason.HALT
    cameras: bool = True


class Ran(NamedTuple):
    drawn: Drawn
    end: Literal["done", "instead", "free", "stuck"]
    why: str  # of a run that is stuck
    given: int  # sentences
    story: list[str]


@cache
def _model(cell: str, cameras: bool = True) -> CellModel:
    if not cameras:
        return CellModel(msgspec.structs.replace(_model(cell).cell, cameras=[]))
    return MODEL if cell == "swapout" else CellModel(Cell.load(cell))


def _bench(model: CellModel) -> Bench:
    bench = Bench(Halting(model.cell), model)
    bench.subsystem.bench = bench
    return bench


@cache
def _known(start: str, arm: str) -> tuple[World, dict[str, Any]]:
    """World and truth after the sentences that lead to a start."""
    name, led, _ = STARTS[start]
    model = _model(name)
    bench = _bench(model)
    for sentence in led:
        run = bench.do(sentence.format(**_names(arm)))
        assert run.succeeded, (sentence, run.refusal, run.failure)
    reporter = bench.subsystem
    return bench.world, {key: getattr(reporter, key) for key in ("poses", "joints", "widths", "forces")}


def _at(start: str, arm: str, cameras: bool) -> Bench:
    world, truth = _known(start, arm)
    model = _model(STARTS[start][0], cameras)
    bench = _bench(model)
    bench.world = world
    for key, value in copy.deepcopy(truth).items():
        setattr(bench.subsystem, key, value)
    return bench


def _names(arm: str) -> dict[str, str]:
    module, handle, rack = ARMS[arm]
    other = next(name for name in ARMS if name != arm)
    return {"arm": arm, "other": other, "module": module, "handle": handle, "rack": rack}


def draw(random: np.random.Generator) -> Drawn:
    start = str(random.choice(list(STARTS), p=SHARES))
    arm = "LEFT-ARM" if "door" in start else str(random.choice(list(ARMS)))
    sign = -1 if random.random() < 0.5 else 1
    figures = {"cm": f"{sign * random.uniform(4, 20):.1f}", "deg": f"{random.uniform(15, 75):.0f}"}
    sentence = str(random.choice(STARTS[start][2]))
    axis = str(random.choice(["X", "Y", "Z", "UP"]))
    drawn = Drawn(
        start,
        arm,
        sentence.format(**_names(arm), **figures, axis=axis),
        motion=int(random.choice([1, 1, 1, 2, 2, 3, 4, 5, 6])),
        share=float(random.uniform(0.05, 0.95)),
    )
    return drawn if random.random() < 0.5 else _with_another(drawn, figures, axis, random)


def _with_another(drawn: Drawn, figures: dict[str, str], axis: str, random: np.random.Generator) -> Drawn:
    """With another sentence after the stop."""
    name = STARTS[drawn.start][0]
    cell, names = _model(name).cell, _names(drawn.arm)
    words = {
        "place": str(random.choice([place.name for place in cell.places])),
        "seat": str(random.choice([seat.name for seat in cell.seats])),
        "neighbour": ARMS[names["other"]][0],
        "far": str(random.choice([-300, -100, -60, 60, 100, 300])),
    }
    return drawn._replace(
        later=str(random.choice(LATER[name])).format(**names, **figures, **words, axis=axis),
        stop=StopReason(random.choice(STOPS)),
        cameras=bool(random.random() < 0.75),
    )


def run(n: int) -> Ran:
    """The run of this number: sentences are drawn until one is halted."""
    random = np.random.default_rng([SEED, n])
    for _ in range(ATTEMPTS):
        if (found := halt_and_follow(draw(random), random)) is not None:
            return found
    raise AssertionError(f"run {n}: {ATTEMPTS} sentences ended without a halt")


def halt_and_follow(drawn: Drawn, random: np.random.Generator) -> Ran | None:
    """None: nothing has been halted."""
    bench = _at(drawn.start, drawn.arm, drawn.cameras)
    reporter = bench.subsystem
    if "door" in drawn.start:
        _displace(reporter, random)
    reporter.motions, reporter.share, reporter.stop = drawn.motion, drawn.share, drawn.stop
    halted = bench.do(drawn.sentence)
    if halted.succeeded or drawn.stop not in halted.reasons:
        return None
    reporter.motions = 0
    _swing(bench, random)
    given: list[str] = []
    moved: list[str] = []

    def say(sentence: str) -> Answer:
        given.append(sentence)
        answer = Answer.of(bench.do(sentence))
        if answer.succeeded and sentence.split()[0] in MOTIONS:
            moved.append(sentence)
        return answer

    def truth() -> dict[str, Any]:
        seats = {seat.name: seat.frame.pose for seat in bench.model.cell.seats}
        return {"poses": reporter.poses, "seats": seats}

    aim, first = drawn.later or drawn.sentence, Answer.of(halted)
    story = [f"halted: {first}"]
    if drawn.later:
        first = say(aim)
        if first.succeeded:
            return Ran(drawn, "done", "", 1, story)
        given.clear()
    elif not advice.first(first.clears, aim, truth) and not first.done:
        first = say(aim)  # nothing holds the arm
        if first.succeeded:
            return Ran(drawn, "done", "", 1, story)
    followed = advice.follow(say, aim, first, truth)
    story += followed.history
    if followed.end in ("reached", "instead") and len(given) <= advice.MAX_SENTENCES:
        return Ran(drawn, "done" if followed.end == "reached" else "instead", "", len(given), story)
    if followed.end != "same advice" and any(one in given[: advice.MAX_SENTENCES] for one in moved):
        return Ran(drawn, "free", "", len(given), story)
    why = followed.end if followed.end not in ("reached", "instead") else "too many sentences"
    return Ran(drawn, "stuck", why, len(given), story)


def _displace(reporter: Reporter, random: np.random.Generator) -> None:
    """The satellite with what is mounted on it, somewhere else than it is believed to be."""
    by = geometry.from_rpy(
        random.uniform(-DISPLACED_M, DISPLACED_M, 3), random.uniform(-DISPLACED_RAD, DISPLACED_RAD, 3)
    )
    satellite = reporter.poses["SATELLITE"]
    to = geometry.compose(geometry.compose(satellite, by), geometry.inverse(satellite))
    for name in ("SATELLITE", "DOOR-2", "BOLT-1", "BOLT-2"):
        reporter.poses[name] = geometry.compose(to, reporter.poses[name])


def _swing(bench: Bench, random: np.random.Generator) -> None:
    """What hands hold lies a little otherwise in them. A door turns about its hinge alone."""
    by = geometry.from_rpy(random.uniform(-OFF_M, OFF_M, 3), random.uniform(-OFF_RAD, OFF_RAD, 3))
    for thing in bench.model.cell.objects:
        if thing.hinge is None and bench.world.value(f"{thing.name}.held_by"):
            bench.subsystem.poses[thing.name] = geometry.compose(bench.subsystem.poses[thing.name], by)


def main() -> None:
    words = numbered_runs.arguments(__doc__, runs=300)
    words.add_argument("--from", type=int, default=0, dest="first", help="the first run")
    given = words.parse_args()
    question("after_stops", "does the advice lead out after every halt, within four sentences?", seed=SEED)
    found: list[Ran] = []
    for n in given.only or range(given.first, given.runs):
        one = run(n)
        found.append(one)
        print(f"  run {n}: {one.drawn}: {one.end}, {one.given} sentences {one.why}", flush=True)
        if one.end == "stuck" or given.only:
            print("\n".join(f"      {line}" for line in one.story), flush=True)
    _report(found, kept=not given.only and not given.first)


def _report(found: list[Ran], *, kept: bool) -> None:
    led = sum(one.end != "stuck" for one in found)
    low, high = wilson(led, len(found))
    rows = [
        ("halts", f"{len(found)}; by start {dict(Counter(one.drawn.start for one in found))}"),
        ("led out within four sentences", f"{led} (Wilson {100 * low:.1f} to {100 * high:.1f} %)"),
        ("ends", f"{dict(Counter(one.end for one in found))}"),
        ("sentences", f"{dict(sorted(Counter(one.given for one in found).items()))}"),
        ("stuck", f"{dict(Counter(one.why for one in found if one.end == 'stuck'))}"),
    ]
    same = sum(one.why == "same advice" for one in found)
    metrics: dict[str, float | None] = {"runs": len(found), "led_out": led, "low": low, "high": high, "same": same}
    numbered_runs.report("after_stops", metrics, rows, kept=kept)


if __name__ == "__main__":
    main()
