"""The operator of the swap-out is a program: it moves where it is asked, and repeats DONE until it is believed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from examples.swapout import lines, scripted_operator, swapout
from examples.swapout.scripted_operator import DIALOGUES, Act, Hands
from rtc.client.hand_controller import PERIOD_S
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind, RtcError
from rtc.spatial import geometry

START = geometry.from_rpy([0.0] * 3, [0.0] * 3)


class Clock:
    """Time that passes only where the program sleeps."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class Arm:
    """An arm that follows each twist for one period, and a cluster that believes the `believed`-th DONE."""

    def __init__(self, believed: int = 1) -> None:
        self.arm, self.request, self.pose = "RIGHT-ARM", "move RIGHT-ARM to neighborhood of BOLT-2", START
        self.believed, self.given, self.acts, self.over = believed, 0, list[Act](), False

    @property
    def operation(self) -> m.TeleopState | None:
        return m.TeleopState(request=self.request, centre=[0.0, 0.0, 0.0]) if self.request else None

    @property
    def state(self) -> Any:
        return SimpleNamespace(tcp_pose=self.pose.tolist(), velocities=[0.0] * 6, wrench=[0.0] * 6)

    def move(self, twist: Any = (0.0,) * 6, hand: str = "", **_: Any) -> str:
        turned = geometry.compose(geometry.from_rpy([0.0] * 3, PERIOD_S * np.asarray(twist[3:])), self.pose)
        self.pose = geometry.make_pose(self.pose[:3] + PERIOD_S * np.asarray(twist[:3]), turned[3:])
        return "the hand is not part of this request" if hand else ""

    def release(self) -> str:
        return ""

    def run(self, sentence: str, **_: Any) -> Any:
        self.given += 1
        good = self.given >= self.believed
        kind = OutcomeKind.SUCCEEDED if good else OutcomeKind.REFUSED
        return SimpleNamespace(outcome=Outcome(kind=kind, message="" if good else "the arm still moves"))


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(scripted_operator, "time", clock)
    return clock


def hands(arm: Arm) -> Hands:
    return Hands(arm, arm, arm.acts.append, lambda: arm.over)  # type: ignore[arg-type]


def test_the_operator_brings_the_arm_to_a_pose() -> None:
    arm, goal = Arm(), geometry.from_rpy([0.05, -0.02, 0.1], [0.2, 0.0, -0.1])
    hands(arm).go(goal)
    assert geometry.distance(arm.pose, goal) < 0.002
    assert geometry.angle(arm.pose, goal) < 0.011


def test_the_operator_says_done_until_it_is_believed_and_gives_up_after_that() -> None:
    arm = Arm(believed=3)
    hands(arm).done()
    assert [bool(why) for _, why in arm.acts] == [True, True, False]
    with pytest.raises(RtcError, match="still moves"):
        hands(Arm(believed=100_000)).done()


def test_a_mistaken_close_is_recorded_as_refused() -> None:
    arm = Arm()
    hands(arm).close_by_mistake()
    assert arm.acts == [Act("closes the hand", "the hand is not part of this request")]


class Starved(Arm):
    """On a busy machine: only every hundredth moment of the stream is in time, and turns the bolt a little."""

    def __init__(self) -> None:
        super().__init__()
        self.request, self.moments, self.turned = "turn BOLT-2 counterclockwise", 0, 0.0

    def move(self, twist: Any = (0.0,) * 6, hand: str = "", turn: float = 0.0, **_: Any) -> str:
        self.moments += 1
        if self.moments % 100:
            return "stale: it has seen nothing of this subsystem for 0.31 s; 0.2 s are allowed"
        self.turned = min(8.0, self.turned + abs(turn))
        return super().move(twist, hand)

    def truth(self) -> Any:
        return SimpleNamespace(poses={"BOLT-2": geometry.translate(START, [0.0, 0.0, 0.001 * self.turned])})

    def run(self, sentence: str, **_: Any) -> Any:
        good = self.turned > 7.9
        kind = OutcomeKind.SUCCEEDED if good else OutcomeKind.REFUSED
        return SimpleNamespace(outcome=Outcome(kind=kind, message="" if good else f"{self.turned} of 8 turns"))


def test_the_operator_turns_again_what_a_refused_done_shows_to_be_missing() -> None:
    arm = Starved()
    it = hands(arm)
    it.done(lambda: scripted_operator._turn(it))
    assert arm.turned == 8.0
    assert len(arm.acts) >= 8  # a poll in which nothing moves is no proof


def test_the_operator_waits_for_the_answer_to_a_mistake() -> None:
    arm = Starved()
    hands(arm).close_by_mistake()
    assert arm.acts == [Act("closes the hand", "the hand is not part of this request")]


def test_the_operator_does_not_go_on_without_the_arm() -> None:
    arm = Arm()
    arm.request = ""
    with pytest.raises(RtcError, match="not the operator's"):
        hands(arm).feel(np.array([0.0, 0.0, 1.0]))
    with pytest.raises(RtcError, match="request is not to"):
        hands(arm).wait("turn")


def test_the_operator_waits_no_longer_than_the_command_lasts(clock: Clock) -> None:
    arm = Arm()
    arm.over = True
    with pytest.raises(RtcError, match="request is not to"):
        hands(arm).wait("turn")
    assert clock.now_s < 1.0


def test_the_lines_of_the_dialogues_are_the_operators() -> None:
    texts = {line.label: line.text for line in lines.read(swapout.LINES.read_text())}
    assert all("OPERATOR-INTERVENTION" in texts[label] or "SHARED" in texts[label] for label in DIALOGUES)
    assert {label for label, text in texts.items() if "OPERATOR" in text or "SHARED" in text} == set(DIALOGUES)
