"""What goes wrong in the swap-out on purpose, when it does, and how the task must take it.

BOLT-2 is stripped in the whole task, and the carry of both arms is halted in its part `insertion`. The check of each
looks at the trace: who noticed, at which level it was repaired, and what was reported. The campaign `injections` has
the others of the scenario.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from examples.swapout.lines import Course, Line
from rtc.apps.demos.narrator import Narrator
from rtc.client.client import Client
from rtc.client.halt import HaltResult
from rtc.protocol import messages as m
from rtc.protocol.faults import StrippedBolt
from rtc.protocol.outcomes import OutcomeKind

CELL, HALFWAY = "servicing", "halfway"  # before the first line; before C22
HALT_AFTER_S = 0.3  # from the begin of the motion of both arms
REST_S = 60.0
AT_REST_S = 0.5  # of simulated time: two arms that carry 2 kg brake softly (decision 0114)
OPENED = ["C3", "C5", "C7"]
CARRIED = ["C4", "C22", "C24", "C25"]
GOOD = (OutcomeKind.SUCCEEDED,)


@dataclass
class Scene:
    """A run with an injection."""

    run_dir: Path
    rtc: Client
    halt: Future[HaltResult] = field(default_factory=Future)  # its answer may come after the end of the line
    struck: list[str] = field(default_factory=list)  # names of processes
    command: str = ""  # in which it happens
    step: str = ""  # of the command, at present


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


def strip(scene: Scene) -> None:
    scene.rtc.inject(StrippedBolt(bolt="BOLT-2"))


def halt_all(scene: Scene) -> None:
    """A little later, from a thread of its own: `halt` has sockets of its own."""
    if not scene.struck:
        scene.struck.append("HALT ALL")
        threading.Timer(HALT_AFTER_S, lambda: scene.halt.set_result(scene.rtc.halt("ALL", REST_S))).start()


def _slips(narrator: Narrator, scene: Scene, course: Course) -> None:
    notes = course.notes(scene.rtc, "C12")
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
    held = [row.name for row in scene.rtc.status().resources if row.owner]
    narrator.check(f"nothing is reserved any more: {held or 'nothing'}", not held)
    for text in ("VERIFY MACS-NEW AT RIGHT-ARM", "VERIFY MACS-NEW AT LEFT-ARM", "LOCATE MACS-NEW", course.texts["C25"]):
        outcome = scene.rtc.run(text, timeout_s=1800.0).outcome
        narrator.check(f"{text}: {outcome.kind.value} {outcome.message}", outcome.kind is OutcomeKind.SUCCEEDED)


STRIPPED = Injection(
    "BOLT-2 is stripped: it slips for ever",
    [*OPENED, "C6", "C10", "C12"],
    "C12",
    strip,
    _slips,
    ends=(OutcomeKind.FAILED,),
)
HALTED = Injection(
    "HALT ALL while both arms carry the module",
    CARRIED,
    "C25",
    halt_all,
    _halted,
    step="with both arms",
    ends=(OutcomeKind.HALTED,),
    cell=HALFWAY,
)
