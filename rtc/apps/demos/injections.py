"""What goes wrong in `rtc demo swapout --inject`, when it does, and how the task must take it.

Each run performs the lines that lead to the event, and asserts the chain on the trace: who noticed, at which level it
was repaired, and what was reported.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from rtc.apps.demos.lines import Course, Line
from rtc.apps.demos.narrator import Narrator
from rtc.client.client import Client
from rtc.client.halt import HaltResult
from rtc.protocol import messages as m
from rtc.protocol.faults import StrippedBolt
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.chaos import Chaos

DISPLACED_M = 0.020  # to where the first search ends without a touch, inside the straddle of the hand
HALT_AFTER_S = 1.0  # from the begin of the motion of both arms
REST_S = 60.0
OPENED = ["C3", "C5", "C7"]
TAKEN_OUT = ["C4", "C22", "C24"]
TO_THE_CARRY = [f"C{n}" for n in range(3, 26) if n != 13]  # the left hand is level only after these
GOOD = (OutcomeKind.SUCCEEDED,)


@dataclass
class Scene:
    """A run with an injection."""

    run_dir: Path
    rtc: Client
    halts: list[HaltResult] = field(default_factory=list)
    struck: list[str] = field(default_factory=list)  # names of processes
    command: str = ""  # in which it happens

    def displace(self) -> None:
        self.rtc.displace("MACS-OLD", [0.0, DISPLACED_M, 0.0, 0.0, 0.0, 0.0])

    def strip(self) -> None:
        self.rtc.inject(StrippedBolt(bolt="BOLT-2"))

    def kill_binder(self) -> None:
        """The binder that has a job of the command; at the next step again, if that one had just finished."""
        if self.lost():
            return
        for worker in self.rtc.status()["workers"]:
            if worker["kind"] == "binder" and worker["busy_with"].partition("/")[0] == self.command:
                hit = Chaos(self.run_dir, random.Random(7)).strike("worker", worker["name"])
                self.struck += [hit.name] if hit else []

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
            threading.Timer(HALT_AFTER_S, lambda: self.halts.append(self.rtc.halt("ALL", REST_S))).start()


class Injection(NamedTuple):
    about: str
    lines: list[str]  # labels of the lines that are performed, in order
    at: str  # the line in which it happens
    strike: Callable[[Scene], None]
    check: Callable[[Narrator, Scene, Course], None]
    step: str = ""  # it happens when a step whose label contains this is bound or executed; empty: before the line
    phase: m.Phase = m.Phase.EXECUTING
    ends: tuple[OutcomeKind, ...] = GOOD  # of the line

    def notes(self, scene: Scene, line: Line, note: m.ProgressNote) -> None:
        if self.step and line.label == self.at and note.phase is self.phase and self.step in note.step:
            scene.command = note.command
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
    halt = scene.halts[0] if scene.halts else None
    narrator.check("the halt is confirmed: both arms rest", halt is not None and halt.confirmed)
    narrator.check("C25 ended as halted", course.ends["C25"].outcome.kind is OutcomeKind.HALTED)
    facts = scene.rtc.world.view(keys=["MACS-NEW.grasp"]).facts
    narrator.check("how MACS-NEW lies in the hand is in doubt", all(f.validity is m.Validity.SUSPECT for f in facts))
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
        TO_THE_CARRY,
        "C25",
        Scene.halt_all,
        _halted,
        step="with both arms",
        ends=(OutcomeKind.HALTED,),
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
