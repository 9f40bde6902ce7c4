"""The operator has brought the hand to a grasp point: where the object is, and how it is turned (R149)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.protocol.messages import Assessment, BoundStep, EndReport
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry

ASKED = "GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM VIA OPERATOR-INTERVENTION"
APART_MM = 12.0


def pointed(bench, of_hand: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Frame and spread of the module after DONE. `of_hand`: its tcp, in the axes of the true grasp point."""
    bench.unsurveyed()
    script = bench.elaborate(ASKED)
    (step,) = [step for step in script.steps if step.effect == "pointed"]
    bound = bench.bind(script, step)
    assert isinstance(bound, BoundStep), bound
    point = bench.model.cell.object("MACS-NEW").grasp_point("HANDLE-A").frame.pose
    tcp = geometry.compose(geometry.compose(true, point), of_hand)
    report = EndReport(
        primitive=bound.primitive.id,
        performer="RIGHT-ARM",
        reason=StopReason.OPERATOR_DONE,
        at_s=1.0,
        duration_s=1.0,
        joints=list(bench.world.value("RIGHT-ARM.joints")),
        tcp_pose=tcp.tolist(),
        wrench=[0.0] * 6,
        hand_width_m=0.08,
        hand_force_n=0.0,
    )
    made = bench.analyze(bound, report)
    assert isinstance(made, Assessment), made
    (change,) = [change for change in made.changes if change.key == "MACS-NEW.frame"]
    return np.asarray(change.value), change.spread


def turned(bench, *rpy: float) -> np.ndarray:
    """The true pose of the module: 12 mm aside, and turned."""
    believed = bench.world.value("MACS-NEW.frame")
    return geometry.compose(believed, geometry.from_rpy([0.0, 0.0, 0.001 * APART_MM], rpy))


def hand(*rpy: float) -> np.ndarray:
    return geometry.from_rpy([0.0, 0.0, 0.0], rpy)


@pytest.mark.parametrize(
    "of_hand", [hand(0.0, 0.0, 0.0), hand(0.0, 0.0, math.pi)], ids=["as planned", "turned by half a turn"]
)
def test_the_object_is_where_and_how_the_hand_shows_it(bench, of_hand) -> None:
    true = turned(bench, 0.03, -0.04, 0.05)
    found, spread = pointed(bench, of_hand, true)
    assert geometry.distance(found, true) < 1e-6
    assert geometry.angle(found, true) < 1e-6
    assert max(spread[3:]) <= 0.0351  # how well the operator sees it, not how badly it was known before


@pytest.mark.parametrize("axis", range(3))
def test_a_hand_that_is_turned_farther_than_the_object_can_be_is_turned_itself(bench, axis: int) -> None:
    rpy = [0.0, 0.0, 0.0]
    rpy[axis] = 0.35
    believed = bench.world.value("MACS-NEW.frame")
    found, spread = pointed(bench, hand(*rpy), turned(bench, 0.0, 0.0, 0.0))
    assert geometry.angle(found, believed) < 1e-6
    assert 1000.0 * geometry.distance(found, believed) == pytest.approx(APART_MM, abs=1e-3)
    assert max(spread[3:]) > 0.08  # about that axis it is known as badly as before
