"""A person at one arm of the swap-out, as a program: sees a request, moves the arm by hand, answers, errs.

Each dialogue is a function of `Hands`; it runs in a thread, with a client of its own, while the planner waits. Hands
use what a person sees: the request, the goal that is shown with it, the measured force, whether the head of a bolt
moves. On a busy machine some messages come too late and do nothing: what a refused DONE shows to be missing, is done
again. A dialogue that cannot go on says CANNOT with the reason, which fails its command.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rtc.client.client import Client
from rtc.client.hand_controller import PERIOD_S, HandController
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.faults import StrippedBolt
from rtc.protocol.outcomes import Outcome, OutcomeKind, RtcError
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

BOLT, DRIVER, PLACE = "BOLT-2", "POWER-DRIVER", "BAY-2-MOUTH"
GAIN_PER_S = 2.0
ARRIVED_M, ARRIVED_RAD = 0.0015, 0.01
BACK_M = 0.06  # along the tool, to look at the head
BEFORE_M = 0.006  # of the head; from there on it is felt for
FEEL_M_S, FELT_N = 0.002, 2.0
TURNED_M = 1e-4  # a head that moves by less within POLL_S rests
POLL_S = 1.0
WRIST_RAD_S, WRIST_MOMENTS = 0.05, 50
REST_RAD_S, REST_S = 0.002, 0.4
LIMIT_S = 1200.0  # of each wait, on a machine with many busy processes


class Act(NamedTuple):
    """What was done, and how it was taken; an empty `why`: it was accepted."""

    what: str
    why: str


class Hands:
    """Hands at one arm, and what they did."""

    def __init__(
        self, rtc: Client, hand: HandController, record: Callable[[Act], None], over: Callable[[], bool]
    ) -> None:
        self.rtc, self.arm = rtc, hand.arm
        self._hand, self._record = hand, record
        self._over = over  # the command has ended

    @property
    def operation(self) -> m.TeleopState:
        """What may be done now. Raises RtcError if the arm is not the operator's any more."""
        operation = self._hand.operation
        if operation is None:
            raise RtcError(f"{self._hand.arm} is not the operator's any more")
        return operation

    @property
    def seen(self) -> m.ArmSample:
        self.operation  # noqa: B018 - the arm is the operator's
        assert self._hand.state is not None
        return self._hand.state

    def wait(self, words: str) -> None:
        """Until this is asked for. Raises RtcError after the limit."""
        end_s = time.monotonic() + LIMIT_S
        while words not in self._hand.request:
            if self._over() or time.monotonic() > end_s:
                raise RtcError(f"the request is not to {words}, but: {self._hand.request or 'nothing'}")
            time.sleep(PERIOD_S)
        self._record(Act(f"is asked: {self._hand.request}", ""))

    def hold(self, **wanted: Any) -> str:
        """One moment of the stream; why it did nothing, or empty."""
        why = self._hand.move(**wanted)
        time.sleep(PERIOD_S)
        return why

    def let_go(self) -> None:
        """Until the arm rests, or nearly so."""
        self._hand.release()
        moved_s = time.monotonic()
        end_s = moved_s + 5.0 * REST_S
        while time.monotonic() < min(end_s, moved_s + REST_S):
            if max(map(abs, self.seen.velocities)) > REST_RAD_S:
                moved_s = time.monotonic()
            time.sleep(PERIOD_S)

    def say(self, sentence: str) -> Outcome:
        outcome = self.rtc.run(sentence, timeout_s=LIMIT_S).outcome
        self._record(Act(sentence, "" if outcome.kind is OutcomeKind.SUCCEEDED else outcome.message))
        return outcome

    def done(self, again: Callable[[], None] = lambda: None) -> None:
        """DONE until it is believed; `again`: what is done after each refusal. Raises RtcError after the limit."""
        end_s = time.monotonic() + LIMIT_S
        while True:
            self.let_go()
            if (outcome := self.say("DONE")).kind is OutcomeKind.SUCCEEDED:
                return
            if self._over() or time.monotonic() > end_s:
                raise RtcError(f"DONE is not believed: {outcome.message}")
            again()

    def close_by_mistake(self) -> None:
        """Until the answer says that the hand is not the operator's. Raises RtcError after the limit."""
        end_s = time.monotonic() + LIMIT_S
        while "the hand" not in (why := self.hold(hand="close")):
            if time.monotonic() > end_s:
                raise RtcError("the hand closes")
        self._record(Act("closes the hand", why))
        self.let_go()

    def go(self, goal: Array) -> None:
        """Bring the tcp to a pose (world). Raises RtcError after the limit."""
        end_s = time.monotonic() + LIMIT_S
        while time.monotonic() < end_s:
            here = self.seen.tcp_pose
            off, turn = np.asarray(goal[:3]) - here[:3], geometry.rotation_vector(here, goal)
            if np.linalg.norm(off) < ARRIVED_M and np.linalg.norm(turn) < ARRIVED_RAD:
                return
            self.hold(twist=[*(GAIN_PER_S * off), *(GAIN_PER_S * turn)])
        raise RtcError(f"the arm does not come nearer than {1e3 * float(np.linalg.norm(off)):.1f} mm")

    def feel(self, along: Array) -> None:
        """Move along a direction until a force is felt. Raises RtcError after the limit."""
        end_s = time.monotonic() + LIMIT_S
        while float(np.linalg.norm(self.seen.wrench[:3])) < FELT_N:
            if time.monotonic() > end_s:
                raise RtcError("nothing is felt")
            self.hold(twist=[*(FEEL_M_S * along), 0.0, 0.0, 0.0])


def turn_the_bolt(it: Hands, cell: Cell) -> None:
    """C13: the bolt whose driver has slipped. Looks, errs twice, seats the driver by feel, and turns."""
    it.wait(f"neighborhood of {BOLT}")
    at = it.seen.tcp_pose
    ahead = geometry.rotate(at, [0.0, 0.0, 1.0])
    head = geometry.make_pose(it.operation.centre, at[3:])  # a driver at its bolt stands along it
    it.go(geometry.translate(head, -BACK_M * ahead))
    it.done()
    it.wait(f"grasp point of {BOLT}")
    it.say("DONE")
    it.close_by_mistake()
    it.go(geometry.translate(head, -BEFORE_M * ahead))
    it.go(geometry.translate(it.seen.tcp_pose, _beside(it, cell, ahead)))
    it.feel(ahead)
    it.done()
    it.wait(f"turn {BOLT}")
    it.rtc.undo_fault(StrippedBolt(bolt=BOLT).name)  # by hand the driver bites
    it.say("DONE")
    _turn(it)
    it.done(lambda: _turn(it))


def _beside(it: Hands, cell: Cell, ahead: Array) -> Array:
    """From the tip of the driver to before the head, across the tool (m, world): what a person sees there. The driver
    may stand askew in the hand, and its tip is 19 cm away; a head takes a tip that is at most 3 mm beside it."""
    spindle, poses = cell.object(DRIVER).spindle, it.rtc.truth().poses
    assert spindle is not None
    tip = geometry.compose(np.asarray(poses[DRIVER]), spindle.frame.pose)
    off = np.asarray(poses[BOLT][:3]) - tip[:3]
    across: Array = off - float(off @ ahead) * ahead
    return across


def _turn(it: Hands) -> None:
    """Until the head rests: the spindle stops by itself after what was asked, or no message has come in
    time."""
    end_s, before = time.monotonic() + LIMIT_S, it.rtc.truth().poses[BOLT]
    while time.monotonic() < end_s:
        polled_s = time.monotonic() + POLL_S
        while time.monotonic() < polled_s:
            it.hold(turn=-1.0)
        now = it.rtc.truth().poses[BOLT]
        if geometry.distance(now, before) < TURNED_M:
            return
        before = now
    raise RtcError("the bolt turns without end")


def guide_the_wrist(it: Hands, cell: Cell) -> None:
    """C27: the program brings the module before the bay; a person holds it level, after a turn that is taken back."""
    it.wait("its WRIST is yours")
    it.say("DONE")
    level = cell.place(PLACE).poses[it.arm].pose
    _hold_level(it, level, aside=WRIST_MOMENTS)
    it.done(lambda: _hold_level(it, level))


def _hold_level(it: Hands, level: Array, aside: int = 0) -> None:
    """Until the arm is at the end of the way with this attitude. `aside`: for so many moments the hand is also turned
    away. Raises RtcError after the limit."""
    end_s = time.monotonic() + LIMIT_S
    for moment in itertools.count():
        turn = geometry.rotation_vector(it.seen.tcp_pose, level)
        operation = it.operation
        arrived = (operation.off_m or 0.0) < 0.5 * (operation.done_m or 0.0)
        if arrived and np.linalg.norm(turn) < ARRIVED_RAD:
            return
        if time.monotonic() > end_s:
            raise RtcError("the arm does not arrive")
        away = [WRIST_RAD_S if moment < aside else 0.0, 0.0, 0.0]
        it.hold(twist=[0.0, 0.0, 0.0, *(a + GAIN_PER_S * b for a, b in zip(away, turn, strict=True))])


Dialogue = Callable[[Hands, Cell], None]
#: label of a line -> its dialogue
DIALOGUES: dict[str, Dialogue] = {"C13": turn_the_bolt, "C27": guide_the_wrist}


class ScriptedOperator:
    """Performs the dialogue of a line, from its begin to its end. `acts`: label -> what was done, in order."""

    def __init__(self, run_dir: Path, cell: Cell, arm: str = "RIGHT-ARM") -> None:
        self.acts: dict[str, list[Act]] = {}
        self._run_dir, self._cell, self._arm = run_dir, cell, arm
        self._thread: threading.Thread | None = None
        self._over = threading.Event()

    def begin(self, label: str) -> None:
        self._over.clear()
        self._thread = threading.Thread(target=self._perform, args=(label,), name=f"operator {label}", daemon=True)
        self._thread.start()

    def end(self, label: str) -> Sequence[Act]:
        """What was done, once the command has ended."""
        assert self._thread is not None
        self._over.set()
        self._thread.join(LIMIT_S)
        return self.acts.get(label, [])

    def _perform(self, label: str) -> None:
        acts = self.acts.setdefault(label, [])
        with Client(self._run_dir) as rtc, rtc.hand(self._arm, "ADA") as hand:
            try:
                DIALOGUES[label](Hands(rtc, hand, acts.append, self._over.is_set), self._cell)
            except RtcError as error:
                acts.append(Act("gives up", str(error)))
                if not self._over.is_set():
                    rtc.run(f'CANNOT "{str(error)[:100].replace(chr(34), chr(39))}"', timeout_s=LIMIT_S)
