"""The quick test of a tick: it never passes when a stop function is true, and does pass when none is near."""

from __future__ import annotations

import math

import pytest

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.motion.arm import Motion
from rtc.subsystems.motion.bounds import LOWER, ConditionBounds
from rtc.subsystems.motion.observation import Observation
from rtc.subsystems.motion.stop_functions import CHECKS, compile_stops, first

CONDITIONS = [
    (StopReason.JOINT_LIMIT, p.JointMarginBelow(0.1)),
    (StopReason.COLLISION, p.BodyTouch()),
    (StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0)),
    (StopReason.CONTACT, p.ForceAbove(limit_n=5.0, axis=[0.0, 0.6, -0.8])),
    (StopReason.TORQUE_LIMIT, p.TorqueAbove(limit_nm=2.0)),
    (StopReason.CONTACT, p.TorqueAbove(limit_nm=1.0, axis=[0.0, 0.0, 1.0])),
    (StopReason.SLIP, p.GripForceBelow(20.0)),
    (StopReason.OBJECT_LOST, p.HandWidthBelow(0.018)),
    (StopReason.FORCE_LIMIT, p.GripForceAbove(40.0)),
    (StopReason.TIMEOUT, p.TimeAbove(5.0)),
    (StopReason.OVERSPEED, p.SpeedAbove(0.5)),
]
CALM: dict[str, object] = {
    "turned": [0.0] * 6,
    "speeds": [0.1] * 6,
    "wrench": [0.3] * 6,
    "forces": (30.0, 30.0),
    "width": 0.02,
    "touches": {},
    "meets": {},
    "lag": 0.01,
    "elapsed_s": 1.0,
}
TOO_MUCH: list[dict[str, object]] = [
    {"elapsed_s": 5.01},
    {"wrench": [0.0, 0.0, -30.1, 0.0, 0.0, 0.0]},
    {"wrench": [0.0, 3.1, -4.1, 0.0, 0.0, 0.0]},  # along an axis
    {"wrench": [0.0, 0.0, 0.0, 2.1, 0.0, 0.0]},
    {"wrench": [0.0, 0.0, 0.0, 0.0, 0.0, 1.1]},
    {"forces": (19.9, 30.0)},
    {"forces": (30.0, 40.1)},
    {"width": 0.0179},
    {"touches": {"forearm touches SATELLITE": 3.0}},
    {"meets": {"RIGHT-ARM forearm touches LEFT-ARM palm": 3.0}},
    {"speeds": [0.0, 0.0, -9.0, 0.0, 0.0, 0.0]},
    {"lag": 0.101},
]


def primitive(*conditions: tuple[StopReason, p.Predicate]) -> p.Primitive:
    complete = (*conditions, (StopReason.TIMEOUT, p.TimeAbove(5.5)), (StopReason.GOAL, p.GoalReached()))
    stops = [p.StopFunction(reason=reason, when=when) for reason, when in complete]
    return p.Primitive(id="C-1.1", performer="RIGHT-ARM", trajectory=p.HoldStill(), stop_functions=stops)


def sense(rig, seen: Observation, **changes: object) -> float:
    """One tick with these values, the others calm. Returns the time since the start (s)."""
    now = {**CALM, **changes}
    joints = [q + turned for q, turned in zip(rig.home, now["turned"], strict=True)]
    rig.arm.motion = (joints, now["speeds"], [0.0] * 6)
    rig.arm.wrench, rig.arm.forces, rig.arm.width = now["wrench"], now["forces"], now["width"]
    rig.arm.leaning, rig.arm.meeting, rig.arm.lag = now["touches"], now["meets"], now["lag"]
    seen.read()
    seen.feel()
    return now["elapsed_s"]


def quiet(bounds: ConditionBounds, seen: Observation, elapsed_s: float, command: Motion) -> bool:
    """The whole test of a tick, as the executor makes it."""
    return elapsed_s <= bounds.time_s and bounds.hold(seen, command)


def checked(rig, *conditions: tuple[StopReason, p.Predicate]):
    stops = compile_stops(primitive(*conditions), rig.arm.traits)
    return stops, ConditionBounds(stops, rig.arm.traits), Observation(rig.arm)


def test_a_tick_far_from_every_limit_passes(rig) -> None:
    _, bounds, seen = checked(rig, *CONDITIONS)
    for turned in (0.0, 0.01, 0.3):
        assert quiet(bounds, seen, sense(rig, seen, turned=[turned] * 6), rig.arm.motion)


@pytest.mark.parametrize("change", TOO_MUCH, ids=str)
def test_a_tick_in_which_a_stop_function_is_true_does_not_pass(rig, change) -> None:
    stops, bounds, seen = checked(rig, *CONDITIONS)
    assert quiet(bounds, seen, sense(rig, seen), rig.arm.motion)
    elapsed_s = sense(rig, seen, **change)
    assert first(stops, seen.moment(elapsed_s, None, rig.arm.motion)) is not None
    assert not quiet(bounds, seen, elapsed_s, rig.arm.motion)


def test_a_value_that_is_not_a_number_does_not_pass(rig) -> None:
    _, bounds, seen = checked(rig, *CONDITIONS)
    assert quiet(bounds, seen, sense(rig, seen), rig.arm.motion)
    for change in ({"wrench": [math.nan] + [0.0] * 5}, {"speeds": [math.nan] * 6}, {"turned": [math.nan] * 6}):
        assert not quiet(bounds, seen, sense(rig, seen, **change), rig.arm.motion)


@pytest.mark.parametrize("joint", range(6))
def test_a_joint_that_walks_to_its_limit_is_noticed_in_the_tick_in_which_it_is_there(rig, joint) -> None:
    stops, bounds, seen = checked(rig, CONDITIONS[0])
    step = (rig.arm.traits.upper[joint] - rig.home[joint]) / 97.3
    passed = 0
    for n in range(98):
        turned = [0.0] * 6
        turned[joint] = n * step
        elapsed_s = sense(rig, seen, turned=turned, lag=0.0)
        passes = quiet(bounds, seen, elapsed_s, rig.arm.motion)
        assert not (passes and first(stops, seen.moment(elapsed_s, None, rig.arm.motion)))
        passed += passes
    assert 30 < passed < 98


@pytest.mark.parametrize("when", [p.TcpNear(point=[0.0, 0.0, 0.0], distance_m=0.1), p.GripForceBelow(9.0, True)])
def test_a_condition_without_a_bound_is_always_checked(rig, when) -> None:
    _, bounds, seen = checked(rig, (StopReason.CONTACT, when))
    assert not quiet(bounds, seen, sense(rig, seen), rig.arm.motion)


def test_every_condition_with_a_bound_is_one_that_can_be_checked() -> None:
    assert LOWER.keys() < CHECKS.keys()
