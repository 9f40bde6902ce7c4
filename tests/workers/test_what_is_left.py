"""A relative sentence that ends before its amount says what is left, and one that has turned as far has succeeded."""

from __future__ import annotations

import math
from typing import Any

import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import EndReport, Script
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import JointTrajectory
from rtc.spatial import geometry
from tests.workers.conftest import Bench, Reporter, record
from workers.planning.robot_models import CellModel

SERVICING = Cell.load("servicing")
MODEL = CellModel(SERVICING)
HELD = ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
DOOR = ("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL",)


def ended(bench: Bench, sentence: str, share: float, reason: StopReason, aside_m: float = 0.0) -> tuple[float, Any]:
    """The last motion of a sentence ends after this share of its path, and the hand is aside: the way that is left (m),
    and the verdict."""
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    step = next(one for one in reversed(script.steps) if one.to)
    bound = bench.bind(script, step)
    path = bound.primitive.trajectory
    assert isinstance(path, JointTrajectory)
    at = path.positions[round(share * (len(path.positions) - 1))]
    arm = bound.primitive.performer
    pose = bench.model.arms[arm].fk(at).tolist()
    pose[1] += aside_m
    report = EndReport(
        primitive=bound.primitive.id,
        performer=arm,
        reason=reason,
        at_s=0.0,
        duration_s=1.0,
        joints=list(at),
        tcp_pose=pose,
        wrench=[0.0] * 6,
        hand_width_m=bench.world.value(f"{arm}.hand_width") or 0.02,
        hand_force_n=30.0,
    )
    left_m = geometry.distance(bench.model.arms[arm].fk(path.positions[-1]), pose)
    return left_m, bench.analyze(bound, report)


@pytest.fixture
def laden(bench: Bench) -> Bench:
    for sentence in HELD:
        assert bench.do(sentence).succeeded
    return bench


@pytest.fixture
def at_door() -> Bench:
    bench = Bench(Reporter(SERVICING), MODEL)
    for sentence in DOOR:
        assert bench.do(sentence).succeeded
    return bench


@pytest.mark.parametrize("reason", [StopReason.HALT, StopReason.TIMEOUT, StopReason.GOAL])
@pytest.mark.parametrize(
    ("sentence", "begins", "ends"),
    [
        ("LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM", "LIFT MACS-NEW BY ", "WITH RIGHT-ARM"),
        ("MOVE RIGHT-ARM BY 10 CM ALONG Z GUARDED", "MOVE RIGHT-ARM BY ", "ALONG Z GUARDED"),
        ("MOVE RIGHT-ARM BY -10 CM ALONG TOOL-X", "MOVE RIGHT-ARM BY -", "ALONG TOOL-X"),
        ("PULL MACS-NEW BY 10 CM WITH RIGHT-ARM", "PULL MACS-NEW BY ", "WITH RIGHT-ARM"),
    ],
)
def test_a_way_that_ends_early_says_how_much_is_left(
    laden: Bench, sentence: str, begins: str, ends: str, reason: StopReason
) -> None:
    left_m, made = ended(laden, sentence, 0.5, reason)
    advised = next(text for text in sentences_of(made.clears) if text.startswith(begins))
    assert ends in advised
    assert abs(float(advised.removeprefix(begins).split()[0])) == pytest.approx(100.0 * left_m, abs=0.1)
    assert record(advised)


def test_a_turn_that_ends_early_says_how_much_is_left(at_door: Bench) -> None:
    _, made = ended(at_door, "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM", 0.5, StopReason.HALT)
    advised = made.clears[0].sentences[-1]
    assert advised.startswith("OPEN DOOR-2 BY ")
    assert float(advised.split()[3]) == pytest.approx(28.5, abs=3.0)  # the path is longer than the turn


@pytest.mark.parametrize("aside_m", [0.0, 0.022, -0.022])
def test_a_turn_that_was_reached_has_succeeded_beside_a_displaced_hinge(at_door: Bench, aside_m: float) -> None:
    _, made = ended(at_door, "OPEN DOOR-2 BY 60 DEG WITH LEFT-ARM", 1.0, StopReason.GOAL, aside_m)
    angle = next(change.value for change in made.changes if change.key == "DOOR-2.angle")
    reached = math.degrees(angle) >= 58.8
    assert (made.verdict == "continue") is reached


def test_what_has_come_to_its_end_leaves_nothing(laden: Bench) -> None:
    _, made = ended(laden, "MOVE RIGHT-ARM BY 10 CM ALONG Z", 1.0, StopReason.HALT)
    assert not any(text.startswith("MOVE RIGHT-ARM") for text in sentences_of(made.clears))
