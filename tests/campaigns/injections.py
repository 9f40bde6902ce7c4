"""Does the swap-out take what goes wrong, O1 to O10 of the scenario, as it must: who noticed, repaired and reported?

    python -m tests.campaigns.injections [O1 ...] [--speed max] [--out out]

Each run performs the lines that lead to the event, in half a minute to two minutes, and checks the chain on the trace.
It prints its course, leaves a film, and ends with status 0 if every check has passed. O5 and O6 belong to
`python -m examples.swapout` and to its part `insertion` too. O9 is a test on paper.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from examples.swapout import lines as planner
from examples.swapout import swapout
from examples.swapout.injections import CARRIED, HALFWAY, HALTED, OPENED, STRIPPED, Injection, Scene
from examples.swapout.lines import Course
from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.faults import BluntSeat, Displaced, MisreadHand, WeakHand
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.spatial import geometry
from rtc.wording.notes import in_words
from tests.campaigns.chaos import Chaos

ON_PAPER = "O9"
DISPLACED_M = 0.020  # to where the first search ends without a touch, inside the straddle of the hand
ASIDE_M = 0.002  # of a seat: more than its play
SEATED_M = 0.004
OBSTACLE = [0.36, 0.05, 1.25]  # of POWER-DRIVER with its rack: before the left arm on its way to its stowed posture
REACHED_RAD = 0.01
# More than a third of the force is lost while the right arm brings the module to where the left one takes it.
WEAKENS_N_S = 0.8
AROUND = "MOVE LEFT-ARM TO JOINTS {joints} DEG THROUGH CLEAR-POINT-1 MAINTAIN AVOID-NEIGHBORS BY 3 CM"
LOST = (StopReason.SLIP, StopReason.OBJECT_LOST)


def displace(scene: Scene) -> None:
    scene.rtc.displace("MACS-OLD", [0.0, DISPLACED_M, 0.0, 0.0, 0.0, 0.0])


def misread(scene: Scene) -> None:
    scene.rtc.inject(MisreadHand(arm="RIGHT-ARM"))


def blunt(scene: Scene) -> None:
    scene.rtc.inject(BluntSeat(seat="BAY-2"))
    scene.rtc.inject(Displaced(object="BAY-2", offset=[0.0, ASIDE_M, 0.0, 0.0, 0.0, 0.0]))


def obstruct(scene: Scene) -> None:
    """Elsewhere than the world database states: in the way of the left arm."""
    home = scene.rtc.truth().poses["POWER-DRIVER"][:3]
    offset = [there - here for there, here in zip(OBSTACLE, home, strict=True)]
    scene.rtc.displace("POWER-DRIVER", [*offset, 0.0, 0.0, 0.0])


def weaken(scene: Scene) -> None:
    if not scene.struck:
        scene.struck.append("RIGHT-ARM")
        scene.rtc.inject(WeakHand(arm="RIGHT-ARM", n_s=WEAKENS_N_S))


def binder_killer() -> Callable[[Scene], None]:
    """Of the binder that has a job of the command; at the next step again, if that one had just finished. Once in each
    step: a job that ends three workers is refused."""
    struck_at = ""  # the step in which a binder was killed last

    def strike(scene: Scene) -> None:
        nonlocal struck_at
        if scene.step == struck_at or lost(scene):
            return
        for worker in scene.rtc.status().workers:
            if worker.kind == "binder" and worker.busy_with.partition("/")[0] == scene.command:
                hit = Chaos(scene.run_dir, random.Random(7)).strike("worker", worker.name)
                scene.struck += [hit.name] if hit else []
                struck_at = scene.step

    return strike


def lost(scene: Scene) -> list[m.ProgressNote]:
    """The notes of the command about workers that were lost."""
    notes = scene.rtc.trace(scene.command).notes
    return [one for one in notes if one.kind is m.NoteKind.WORKER_LOST and one.about in scene.struck]


def stop_mcm(scene: Scene) -> None:
    if not scene.struck and (hit := Chaos(scene.run_dir, random.Random(7), stop=True).strike("mcm")):
        scene.struck.append(hit.name)


def _in_order(notes: list[str], *wanted: str) -> bool:
    """Whether notes that contain these words follow one another."""
    left = iter(notes)
    return all(any(words in note for note in left) for words in wanted)


def _seen_and_felt(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = course.notes(scene.rtc, "C16")
    trims = [note.trim for note in notes if note.trim]
    narrator.check(f"nothing was felt; entry 1 of the trimming stack, the camera; entries used: {trims}", trims == [1])
    steps = [note.step for note in notes]
    what = "it looked for the module, felt for it again at both sides, and closed"
    narrator.check(what, _in_order(steps, "(GP1)", "look for MACS-OLD", "(GP1)", "(GP2)", "close on HANDLE-A"))


def _closed_again(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = course.notes(scene.rtc, "C22")
    steps, trims = [note.step for note in notes], [note.trim for note in notes if note.trim]
    narrator.check(f"the hand read empty; entry 1 of the trimming stack, once; entries used: {trims}", trims == [1])
    what = "it opened, went back to the start, and closed again"
    again = ["close on HANDLE-A", "open again", "back off", "(AP)", "(NP)", "(GP)", "close on HANDLE-A"]
    narrator.check(what, _in_order(steps, *again))
    narrator.check("it holds the module", _holds(scene, "MACS-NEW") == "RIGHT-ARM")


def _realigned(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = course.notes(scene.rtc, "C28")
    jams, trims = [note for note in notes if "backed off" in note.message], [note.trim for note in notes if note.trim]
    narrator.check(f"jams at which the MCM backed off by itself: {len(jams)}", bool(jams))
    narrator.check(f"after each a search: entries used of the trimming stack: {trims}", len(trims) == len(jams))
    steps = [note.step for note in notes]
    what = "the module was moved before the bay, and inserted again"
    narrator.check(what, _in_order(steps, "bring", "before BAY-2", "bring", "let go"))
    truth, seat = scene.rtc.truth(), Cell.load(HALFWAY).seat("BAY-2")
    off_m = geometry.distance(truth.poses["MACS-NEW"], geometry.compose(truth.seats["BAY-2"], seat.module_frame.pose))
    narrator.check(f"it is {1e3 * off_m:.1f} mm from its place", off_m <= SEATED_M)


def _went_around(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes, end = course.notes(scene.rtc, "C26"), course.ends["C26"].outcome
    touched = end.stop in (StopReason.FORCE_LIMIT, StopReason.COLLISION, StopReason.CONTACT)
    narrator.check(f"the arm was stopped by a touch on its free way: {end.message}", touched)
    narrator.check("no trim: it is for the planner", not any(note.trim for note in notes))
    stowed = Cell.load(HALFWAY).arm("LEFT-ARM").stow_rad
    for text in ("RETRACT LEFT-ARM", AROUND.format(joints=" ".join(f"{math.degrees(rad):g}" for rad in stowed))):
        outcome = scene.rtc.run(text, timeout_s=1800.0).outcome
        narrator.check(f"{text}: {outcome.kind.value} {outcome.message}", outcome.kind is OutcomeKind.SUCCEEDED)
    joints = scene.rtc.truth().joints["LEFT-ARM"]
    off_rad = max(abs(a - b) for a, b in zip(joints, stowed, strict=True))
    narrator.check(f"the arm is {off_rad:.3f} rad from its stowed posture", off_rad < REACHED_RAD)


def _gripped_again(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = course.notes(scene.rtc, "C25")
    flagged = [note for note in notes if note.trim]
    words, warned = "; ".join(map(in_words, flagged)), all(note.warning for note in flagged)
    narrator.check(f"flagged after a step that had succeeded: {words}", bool(flagged) and warned)
    ended = [note.reason for note in notes if note.kind is m.NoteKind.STEP_ENDED]
    lost = [reason for reason in ended if reason in LOST]
    narrator.check(f"steps that a lost grip has ended: {len(lost)} of {len(ended)}", bool(ended) and not lost)
    what = "the hand closed again before both arms carried the module"
    narrator.check(what, _in_order([note.step for note in notes], "bring", "close again", "with both arms"))


def _holds(scene: Scene, name: str) -> str:
    """The arm that holds it, as the world database states and trusts; empty: none."""
    facts = scene.rtc.world.view(keys=[f"{name}.held_by"]).facts
    return next((str(fact.value) for fact in facts if fact.validity is m.Validity.VALID), "")


def _done_again(narrator: Narrator, scene: Scene, course: Course) -> None:
    gone = lost(scene)
    narrator.check(f"killed while it was at work: {'; '.join(map(in_words, gone)) or 'nothing'}", bool(gone))
    notes = [note for note in course.notes(scene.rtc, "C22") if note not in gone]
    bound = [note.step for note in notes if note.node.startswith("binder@")]
    narrator.check(f"{len(bound)} steps were bound, each once", bool(bound) and len(bound) == len(set(bound)))


def _all_ended(narrator: Narrator, scene: Scene, course: Course) -> None:
    narrator.check(f"stopped, but not ended: {', '.join(scene.struck) or 'nothing'}", bool(scene.struck))
    bad = [end.outcome for end in course.ends.values() if end.outcome.kind is not OutcomeKind.SUCCEEDED]
    narrator.check(f"reported up: {'; '.join(outcome.message for outcome in bad)}", all(one.message for one in bad))


INJECTIONS = {
    "O1": Injection(
        "the module is 20 mm aside, where the first search ends without a touch",
        [*OPENED, "C9", "C16"],
        "C16",
        displace,
        _seen_and_felt,
    ),
    "O2": Injection(
        "the hand reads empty at its first closure, by the simple script of GRASP",
        ["C4", "C22"],
        "C22",
        misread,
        _closed_again,
        text="GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN AVOID-NEIGHBORS BY 2 CM GUARDED VIA GRASP-SIMPLE",
    ),
    "O3": Injection(
        "BAY-2 has no lips, and is 2 mm aside: the module jams while it is inserted",
        [*CARRIED, "C26", "C28"],
        "C28",
        blunt,
        _realigned,
        cell=HALFWAY,
    ),
    "O4": Injection(
        "something stands in the way of the left arm",
        [*CARRIED, "C26"],
        "C26",
        obstruct,
        _went_around,
        ends=(OutcomeKind.FAILED,),
        cell=HALFWAY,
        text="STOW LEFT-ARM",  # with AVOID-NEIGHBORS the MCM stops it before the touch
    ),
    "O5": STRIPPED,
    "O6": HALTED,
    "O10": Injection(
        "the grip of the right hand weakens while it carries the module",
        CARRIED,
        "C25",
        weaken,
        _gripped_again,
        step="bring MACS-NEW",
        cell=HALFWAY,
    ),
    "O7": Injection(
        "a binder is killed while it binds a step of C22",
        ["C4", "C22"],
        "C22",
        binder_killer(),
        _done_again,
        step="of ",
        phase=m.Phase.BINDING,
    ),
    "O8": Injection(
        "the MCM is stopped in the middle of C22",
        ["C4", "C22"],
        "C22",
        stop_mcm,
        _all_ended,
        step="(JAP)",
        ends=(OutcomeKind.FAILED, OutcomeKind.LOST_SUBSYSTEM),
    ),
}


NAMES = sorted([*INJECTIONS, ON_PAPER], key=lambda name: int(name[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaigns.injections",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{NAMES[0]} to {NAMES[-1]}; all if none is given")
    parser.add_argument("--speed", default="max", help="simulated seconds per second, or max")
    parser.add_argument("--out", type=Path, default=Path("out"), help="directory of the films")
    given = parser.parse_args()
    if unknown := set(given.names) - {*NAMES}:
        parser.error(f"not known: {', '.join(unknown)}")
    passed = [run(Console(), name, given.speed, given.out) for name in given.names or NAMES]
    sys.exit(0 if all(passed) else 1)


def run(console: Console, name: str, speed: str, out: Path) -> bool:
    """Perform one of them; True if every check has passed."""
    narrator = Narrator(console)
    if name == ON_PAPER:
        with own_cluster(cell=swapout.CELL, speed=speed) as run_dir, Client(run_dir) as rtc:
            swapout.hypotheses(narrator, rtc, planner.read(swapout.LINES.read_text()))
    else:
        what = INJECTIONS[name]
        part = swapout.Part(what.about, what.cell, what.lines, what, closed=False)
        swapout.show(narrator, name, part, speed, out)
    return narrator.passed()


if __name__ == "__main__":
    main()
