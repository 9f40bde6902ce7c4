"""What goes wrong in `rtc demo swapout --inject`, when it does, and how the task must take it.

Each run performs the lines that lead to the event, and asserts the chain on the trace: who noticed, at which level it
was repaired, and what was reported.
"""

from __future__ import annotations

import math
import random
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from rtc.apps.demos.lines import Course, Line
from rtc.apps.demos.narrator import Narrator
from rtc.client.client import Client
from rtc.client.halt import HaltResult
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.faults import BluntSeat, Displaced, MisreadHand, StrippedBolt, WeakHand
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.runtime.chaos import Chaos
from rtc.spatial import geometry

CELL, HALFWAY = "servicing", "halfway"  # before the first line; before C22
DISPLACED_M = 0.020  # to where the first search ends without a touch, inside the straddle of the hand
ASIDE_M = 0.002  # of a seat: more than its play
SEATED_M = 0.004
OBSTACLE = [0.36, 0.05, 1.25]  # of POWER-DRIVER with its rack: before the left arm on its way to its stowed posture
REACHED_RAD = 0.01
# More than a third of the force is lost while the right arm brings the module to where the left one takes it.
WEAKENS_N_S = 0.8
AROUND = "MOVE LEFT-ARM TO JOINTS {joints} DEG THROUGH CLEAR-POINT-1 MAINTAIN AVOID-NEIGHBORS BY 3 CM"
HALT_AFTER_S = 0.3  # from the begin of the motion of both arms
REST_S = 60.0
AT_REST_S = 0.5  # of simulated time: two arms that carry 2 kg brake softly (decision 0114)
OPENED = ["C3", "C5", "C7"]
CARRIED = ["C4", "C22", "C24", "C25"]
GOOD = (OutcomeKind.SUCCEEDED,)
LOST = (StopReason.SLIP, StopReason.OBJECT_LOST)


@dataclass
class Scene:
    """A run with an injection."""

    run_dir: Path
    rtc: Client
    halt: Future[HaltResult] = field(default_factory=Future)  # its answer may come after the end of the line
    struck: list[str] = field(default_factory=list)  # names of processes
    command: str = ""  # in which it happens
    step: str = ""  # of the command, at present
    struck_at: str = ""  # the step in which a binder was killed last

    def displace(self) -> None:
        self.rtc.displace("MACS-OLD", [0.0, DISPLACED_M, 0.0, 0.0, 0.0, 0.0])

    def strip(self) -> None:
        self.rtc.inject(StrippedBolt(bolt="BOLT-2"))

    def misread(self) -> None:
        self.rtc.inject(MisreadHand(arm="RIGHT-ARM"))

    def blunt(self) -> None:
        self.rtc.inject(BluntSeat(seat="BAY-2"))
        self.rtc.inject(Displaced(object="BAY-2", offset=[0.0, ASIDE_M, 0.0, 0.0, 0.0, 0.0]))

    def obstruct(self) -> None:
        """Elsewhere than the world database states: in the way of the left arm."""
        home = self.rtc.truth().poses["POWER-DRIVER"][:3]
        offset = [there - here for there, here in zip(OBSTACLE, home, strict=True)]
        self.rtc.displace("POWER-DRIVER", [*offset, 0.0, 0.0, 0.0])

    def weaken(self) -> None:
        if not self.struck:
            self.struck.append("RIGHT-ARM")
            self.rtc.inject(WeakHand(arm="RIGHT-ARM", n_s=WEAKENS_N_S))

    def kill_binder(self) -> None:
        """The binder that has a job of the command; at the next step again, if that one had just finished. Once in each
        step: a job that ends three workers is refused."""
        if self.step == self.struck_at or self.lost():
            return
        for worker in self.rtc.status()["workers"]:
            if worker["kind"] == "binder" and worker["busy_with"].partition("/")[0] == self.command:
                hit = Chaos(self.run_dir, random.Random(7)).strike("worker", worker["name"])
                self.struck += [hit.name] if hit else []
                self.struck_at = self.step

    def lost(self) -> list[str]:
        """The notes of the command about workers that were lost."""
        notes = [note.note for note in self.rtc.trace(self.command).notes]
        return [note for note in notes for name in self.struck if note.startswith(f"{name} lost")]

    def stop_mcm(self) -> None:
        if not self.struck and (hit := Chaos(self.run_dir, random.Random(7), stop=True).strike("mcm")):
            self.struck.append(hit.name)

    def halt_all(self) -> None:
        """A little later, from a thread of its own: `halt` has sockets of its own."""
        if not self.struck:
            self.struck.append("HALT ALL")
            threading.Timer(HALT_AFTER_S, lambda: self.halt.set_result(self.rtc.halt("ALL", REST_S))).start()


class Injection(NamedTuple):
    about: str
    lines: list[str]  # labels of the lines that are performed, in order
    at: str  # the line in which it happens
    strike: Callable[[Scene], None]
    check: Callable[[Narrator, Scene, Course], None]
    step: str = ""  # it happens when a step whose label contains this is bound or executed; empty: before the line
    phase: m.Phase = m.Phase.EXECUTING
    ends: tuple[OutcomeKind, ...] = GOOD  # of the line
    cell: str = CELL
    text: str = ""  # of the line, if it differs from that of the task

    def notes(self, scene: Scene, line: Line, note: m.ProgressNote) -> None:
        if self.step and line.label == self.at and note.phase is self.phase and self.step in note.step:
            scene.command, scene.step = note.command, note.step
            self.strike(scene)

    def begins(self, scene: Scene, line: Line) -> None:
        if not self.step and line.label == self.at:
            self.strike(scene)


def _notes(scene: Scene, course: Course, label: str) -> list[m.ProgressNote]:
    return scene.rtc.trace(course.commands[label]).notes


def _in_order(notes: list[str], *wanted: str) -> bool:
    """Whether notes that contain these words follow one another."""
    left = iter(notes)
    return all(any(words in note for note in left) for words in wanted)


def _seen_and_felt(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = _notes(scene, course, "C16")
    trims = [note.trim for note in notes if note.trim]
    narrator.check(f"nothing was felt; entry 1 of the trimming stack, the camera; entries used: {trims}", trims == [1])
    steps = [note.step for note in notes]
    what = "it looked for the module, felt for it again at both sides, and closed"
    narrator.check(what, _in_order(steps, "(GP1)", "look for MACS-OLD", "(GP1)", "(GP2)", "close on HANDLE-A"))


def _closed_again(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = _notes(scene, course, "C22")
    steps, trims = [note.step for note in notes], [note.trim for note in notes if note.trim]
    narrator.check(f"the hand read empty; entry 1 of the trimming stack, once; entries used: {trims}", trims == [1])
    what = "it opened, went back to the start, and closed again"
    again = ["close on HANDLE-A", "open again", "back off", "(AP)", "(NP)", "(GP)", "close on HANDLE-A"]
    narrator.check(what, _in_order(steps, *again))
    narrator.check("it holds the module", _holds(scene, "MACS-NEW") == "RIGHT-ARM")


def _realigned(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = _notes(scene, course, "C28")
    jams, trims = [note.note for note in notes if "backed off" in note.note], [note.trim for note in notes if note.trim]
    narrator.check(f"jams at which the MCM backed off by itself: {len(jams)}", bool(jams))
    narrator.check(f"after each a search: entries used of the trimming stack: {trims}", len(trims) == len(jams))
    steps = [note.step for note in notes]
    what = "the module was moved before the bay, and inserted again"
    narrator.check(what, _in_order(steps, "bring", "before BAY-2", "bring", "let go"))
    truth, seat = scene.rtc.truth(), Cell.load(HALFWAY).seat("BAY-2")
    off_m = geometry.distance(truth.poses["MACS-NEW"], geometry.compose(truth.seats["BAY-2"], seat.module_frame.pose))
    narrator.check(f"it is {1e3 * off_m:.1f} mm from its place", off_m <= SEATED_M)


def _went_around(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes, end = _notes(scene, course, "C26"), course.ends["C26"].outcome
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
    notes = _notes(scene, course, "C25")
    flagged = [note for note in notes if note.trim]
    words, warned = "; ".join(note.note for note in flagged), all(note.warning for note in flagged)
    narrator.check(f"flagged after a step that had succeeded: {words}", bool(flagged) and warned)
    ended = [note.note for note in notes if note.node == "MCM"]
    lost = [words for words in ended for reason in LOST if reason.value in words]
    narrator.check(f"steps that a lost grip has ended: {len(lost)} of {len(ended)}", bool(ended) and not lost)
    what = "the hand closed again before both arms carried the module"
    narrator.check(what, _in_order([note.step for note in notes], "bring", "close again", "with both arms"))


def _holds(scene: Scene, name: str) -> str:
    """The arm that holds it, as the world database states and trusts; empty: none."""
    facts = scene.rtc.world.view(keys=[f"{name}.held_by"]).facts
    return next((str(fact.value) for fact in facts if fact.validity is m.Validity.VALID), "")


def _slips(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = _notes(scene, course, "C12")
    tried = [note.step for note in notes if note.trim]
    narrator.check(f"the trims of LOOSEN were tried: {len(tried)}", bool(tried))
    end = course.ends["C12"]
    narrator.check(f"reported up: {end.outcome.message[:100]}", end.outcome.kind is OutcomeKind.FAILED)
    state = scene.rtc.world.view(keys=["BOLT-2.state", "BOLT-2.turns"]).facts
    doubtful = all(fact.validity is not m.Validity.VALID for fact in state if fact.value is not None)
    narrator.check("the state of BOLT-2 is in doubt", doubtful)


def _halted(narrator: Narrator, scene: Scene, course: Course) -> None:
    halt = scene.halt.result(HALT_AFTER_S + REST_S) if scene.struck else None
    narrator.check("the halt is confirmed: both arms rest", halt is not None and halt.confirmed)
    moving = halt.moving if halt else []
    narrator.check(f"in motion were: {', '.join(moving)}", moving == ["LEFT-ARM", "RIGHT-ARM"])
    own_s = [one.own_rest_s or math.inf for one in halt.subsystems] if halt else [math.inf]
    narrator.check(f"at rest after {1e3 * max(own_s):.0f} ms of simulated time", max(own_s) <= AT_REST_S)
    narrator.check("C25 ended as halted", course.ends["C25"].outcome.kind is OutcomeKind.HALTED)
    facts = {fact.key: fact.validity for fact in scene.rtc.world.view(keys=["MACS-NEW.grasp", "MACS-NEW.frame"]).facts}
    doubtful = set(facts.values()) == {m.Validity.SUSPECT} and len(facts) == 2
    narrator.check("where MACS-NEW is, and how it lies in the hand, is in doubt", doubtful)
    refused = scene.rtc.run(f"RESUME {course.commands['C25']}").outcome
    narrator.check(f"RESUME is refused: {refused.message}", refused.kind is OutcomeKind.REFUSED)
    held = [row["name"] for row in scene.rtc.status()["resources"] if row["owner"]]
    narrator.check(f"nothing is reserved any more: {held or 'nothing'}", not held)
    for text in ("VERIFY MACS-NEW AT RIGHT-ARM", "VERIFY MACS-NEW AT LEFT-ARM", "LOCATE MACS-NEW", course.texts["C25"]):
        outcome = scene.rtc.run(text, timeout_s=1800.0).outcome
        narrator.check(f"{text}: {outcome.kind.value} {outcome.message}", outcome.kind is OutcomeKind.SUCCEEDED)


def _done_again(narrator: Narrator, scene: Scene, course: Course) -> None:
    lost = scene.lost()
    narrator.check(f"killed while it was at work: {'; '.join(lost) or 'nothing'}", bool(lost))
    notes = [note for note in _notes(scene, course, "C22") if note.note not in lost]
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
        Scene.displace,
        _seen_and_felt,
    ),
    "O2": Injection(
        "the hand reads empty at its first closure, by the simple script of GRASP",
        ["C4", "C22"],
        "C22",
        Scene.misread,
        _closed_again,
        text="GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN AVOID-NEIGHBORS BY 2 CM GUARDED VIA GRASP-SIMPLE",
    ),
    "O3": Injection(
        "BAY-2 has no lips, and is 2 mm aside: the module jams while it is inserted",
        [*CARRIED, "C26", "C28"],
        "C28",
        Scene.blunt,
        _realigned,
        cell=HALFWAY,
    ),
    "O4": Injection(
        "something stands in the way of the left arm",
        [*CARRIED, "C26"],
        "C26",
        Scene.obstruct,
        _went_around,
        ends=(OutcomeKind.FAILED,),
        cell=HALFWAY,
        text="STOW LEFT-ARM",  # with AVOID-NEIGHBORS the MCM stops it before the touch
    ),
    "O10": Injection(
        "the grip of the right hand weakens while it carries the module",
        CARRIED,
        "C25",
        Scene.weaken,
        _gripped_again,
        step="bring MACS-NEW",
        cell=HALFWAY,
    ),
    "O5": Injection(
        "BOLT-2 is stripped: it slips for ever",
        [*OPENED, "C6", "C10", "C12"],
        "C12",
        Scene.strip,
        _slips,
        ends=(OutcomeKind.FAILED,),
    ),
    "O6": Injection(
        "HALT ALL while both arms carry the module",
        CARRIED,
        "C25",
        Scene.halt_all,
        _halted,
        step="with both arms",
        ends=(OutcomeKind.HALTED,),
        cell=HALFWAY,
    ),
    "O7": Injection(
        "a binder is killed while it binds a step of C22",
        ["C4", "C22"],
        "C22",
        Scene.kill_binder,
        _done_again,
        step="of ",
        phase=m.Phase.BINDING,
    ),
    "O8": Injection(
        "the MCM is stopped in the middle of C22",
        ["C4", "C22"],
        "C22",
        Scene.stop_mcm,
        _all_ended,
        step="(JAP)",
        ends=(OutcomeKind.FAILED, OutcomeKind.LOST_SUBSYSTEM),
    ),
}
