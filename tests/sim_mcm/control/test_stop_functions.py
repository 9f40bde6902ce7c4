"""F: each predicate against its own moment, and one reason for any moment (R83, A21)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import PRIORITY, StopReason
from rtc.robot.geometry import Array
from sim_mcm.arms.arm import Traits
from sim_mcm.control import stop_functions
from sim_mcm.control.stop_functions import Moment

HERE = np.array([0.5, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0])


def at(x: float, y: float, z: float) -> Callable[[], Array]:
    return lambda: np.array([x, y, z, 0.0, 0.0, 0.0, 1.0])


def moment(**changes: object) -> Moment:
    """A moment in which nothing is the matter."""
    figures = {
        "elapsed_s": 1.0,
        "joints": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
        "velocities": [0.0] * 6,
        "wrench": [0.0] * 6,
        "force_n": 0.0,
        "torque_nm": 0.0,
        "width_m": 0.02,
        "grip_n": 30.0,
        "grip_most_n": 30.0,
        "arrived": None,
        "tcp": lambda: HERE,
        "touch": lambda: "",
        "commanded": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
        "commanded_tcp": lambda: HERE,
        "tcp_speed_m_s": lambda: 0.0,
    }
    if "joints" in changes:
        figures["commanded"] = changes["joints"]
    return Moment(**{**figures, **changes})  # type: ignore[arg-type]


ROWS = [
    (p.GoalReached(), {"arrived": (0.0, 0.002, "")}, {}),
    (p.TimeAbove(1.0), {"elapsed_s": 1.001}, {"elapsed_s": 1.0}),
    (p.ForceAbove(limit_n=5.0), {"force_n": 5.1}, {"force_n": 5.0}),
    (p.ForceAbove(limit_n=5.0, axis=[0, 0, -1]), {"wrench": [0, 0, -6.0, 0, 0, 0]}, {"wrench": [9.0, 9, 6, 0, 0, 0]}),
    (p.TorqueAbove(limit_nm=2.0), {"torque_nm": 2.1}, {"torque_nm": 1.9}),
    (p.TorqueAbove(limit_nm=2.0, axis=[1, 0, 0]), {"wrench": [0, 0, 0, 3.0, 0, 0]}, {"wrench": [9.0, 0, 0, 0, 9, 9]}),
    (
        p.JointMarginBelow(0.05),
        {"joints": [2.75, 1.0, -1.0, 0, 0, 0], "velocities": [0.1, 0, 0, 0, 0, 0]},
        {"joints": [2.75, 1.0, -1.0, 0, 0, 0], "velocities": [-0.1, 0, 0, 0, 0, 0]},  # on its way back
    ),
    (
        p.JointMarginBelow(0.05),
        {"joints": [0, -0.74, -1.0, 0, 0, 0], "velocities": [0, -0.1, 0, 0, 0, 0]},
        {"joints": [0, -0.74, -1.0, 0, 0, 0], "velocities": [0, 0.0, 0, 0, 0, 0]},
    ),
    (p.SpeedAbove(1.2), {"velocities": [0, 0, 0, 0, 0, -5.1]}, {"velocities": [0, 0, 0, 0, 0, -4.7]}),
    (
        p.FollowingErrorAbove(0.05),
        {"commanded": [0.0, 1.0, -1.051, 0.0, 0.0, 0.0]},
        {"commanded": [0.0, 1.0, -1.049, 0.0, 0.0, 0.0]},
    ),
    (p.BodyTouch(), {"touch": lambda: "forearm touches MACS-OLD"}, {}),
    (p.GripForceBelow(20.0), {"grip_n": 19.0}, {"grip_n": 21.0}),
    (p.HandWidthBelow(0.018), {"width_m": 0.017}, {"width_m": 0.019}),
    (p.TcpNear(point=[0.5, 0.0, 0.68], distance_m=0.03), {}, {"tcp": at(0.5, 0.1, 0.7)}),
    (p.TcpNear(point=[0.9, 0.9, 0.68], distance_m=0.03, axis=[0, 0, 1]), {}, {"tcp": at(0.9, 0.9, 0.72)}),
    (p.TcpFar(point=[0.5, 0.0, 0.7], distance_m=0.05), {"tcp": at(0.5, 0.04, 0.74)}, {"tcp": at(0.5, 0.03, 0.73)}),
    (
        p.TcpFar(point=[0.5, 0.0, 0.7], distance_m=0.05, axis=[0, 0, 1]),
        {"tcp": at(0.5, 0.0, 0.64)},
        {"tcp": at(0.9, 0.9, 0.7)},
    ),
    (p.TcpSpeedAbove(0.1), {"tcp_speed_m_s": lambda: 0.11}, {"tcp_speed_m_s": lambda: 0.09}),
    (p.GripForceAbove(40.0), {"grip_most_n": 41.0}, {"grip_most_n": 39.0}),
    (p.TcpOutside(centre=[0.5, 0, 0.7, 0, 0, 0, 1], size_m=[0.2, 0.2, 0.2]), {"tcp": at(0.61, 0, 0.7)}, {}),
    (p.TcpInside(centre=[0.5, 0, 0.7, 0, 0, 0, 1], size_m=[0.2, 0.2, 0.2]), {}, {"tcp": at(0.61, 0, 0.7)}),
    (
        p.TcpTurned(attitude=[0.0, 0.0, 0.0, 1.0], limit_rad=0.1),
        {"tcp": lambda: np.array([0.5, 0.0, 0.7, 0.0, 0.0, math.sin(0.06), math.cos(0.06)])},
        {"tcp": lambda: np.array([0.5, 0.0, 0.7, 0.0, 0.0, math.sin(0.04), math.cos(0.04)])},
    ),
    (
        p.NoProgress(behind_m=0.015, force_n=15.0),
        {"force_n": 16.0, "commanded_tcp": at(0.5, 0.0, 0.716)},
        {"force_n": 16.0, "commanded_tcp": at(0.5, 0.0, 0.714)},
    ),
    (p.NoProgress(behind_m=0.015, force_n=15.0), {"force_n": 16.0, "commanded_tcp": at(0.5, 0, 0.8)}, {}),
]

# (condition, a moment above its limit, one below it)
FALLEN = [
    (p.ForceBelow(limit_n=5.0), {"force_n": 6.0}, {"force_n": 4.0}),
    (p.ForceBelow(limit_n=1.0, armed_n=5.0), {"force_n": 5.5}, {"force_n": 0.5}),
    (
        p.ForceBelow(limit_n=5.0, axis=[0, 0, 1]),
        {"wrench": [0, 0, -6.0, 0, 0, 0]},
        {"wrench": [9.0, 9.0, 1.0, 0, 0, 0], "force_n": 12.8},
    ),
    (p.TorqueBelow(limit_nm=1.0), {"torque_nm": 2.0}, {"torque_nm": 0.5}),
    (p.TorqueBelow(limit_nm=1.0, axis=[1, 0, 0]), {"wrench": [0, 0, 0, 2.0, 0, 0]}, {"wrench": [0, 0, 0, 0, 5.0, 0]}),
]


@pytest.fixture(scope="module")
def traits(cell) -> Traits:
    return Traits.of(cell, "RIGHT-ARM")


@pytest.mark.parametrize(("when", "bad", "good"), ROWS, ids=lambda value: type(value).__name__)
def test_each_predicate_sees_its_condition_and_no_other(traits, make, when, bad, good) -> None:
    wanted = make.primitive(p.HoldStill(), make.stop(StopReason.HALT, when))  # first in priority
    stops = stop_functions.compile_stops(wanted, traits)

    found = stop_functions.first(stops, moment(**bad))
    assert found is not None
    assert found[0].when == when
    assert stop_functions.first(stops, moment(**good)) is None


@pytest.mark.parametrize(("when", "above", "below"), FALLEN, ids=lambda value: type(value).__name__)
def test_a_value_below_its_limit_counts_after_it_has_been_above(traits, make, when, above, below) -> None:
    wanted = make.primitive(p.HoldStill(), make.stop(StopReason.HALT, when))
    stops = stop_functions.compile_stops(wanted, traits)

    assert all(stop_functions.first(stops, moment(**below)) is None for _ in range(100))
    assert stop_functions.first(stops, moment(**above)) is None
    found = [stop_functions.first(stops, moment(**below)) for _ in range(20)]
    assert found[:19] == [None] * 19  # 20 ms
    assert found[19] is not None
    assert found[19][0].when == when


def test_a_value_that_is_low_for_a_moment_only_does_not_count(traits, make) -> None:
    wanted = make.primitive(p.HoldStill(), make.stop(StopReason.HALT, p.ForceBelow(limit_n=5.0)))
    stops = stop_functions.compile_stops(wanted, traits)
    assert all(stop_functions.first(stops, moment(force_n=4.0 if n % 15 else 6.0)) is None for n in range(200))


def test_every_predicate_of_the_contract_can_be_checked() -> None:
    assert set(stop_functions.CHECKS) == set(p.Predicate.__args__)  # type: ignore[attr-defined]


def test_a_joint_near_its_limit_is_named(traits, make) -> None:
    wanted = make.primitive(p.HoldStill(), make.stop(StopReason.JOINT_LIMIT, p.JointMarginBelow(0.05)))
    close = moment(joints=[2.75, 1.0, -1.0, 0, 0, 0], velocities=[0.1, 0, 0, 0, 0, 0])
    found = stop_functions.first(stop_functions.compile_stops(wanted, traits), close)
    assert found is not None
    measured, limit, words = found[1]
    assert measured == pytest.approx(math.radians(160) - 2.75, abs=1e-6)
    assert limit == 0.05
    assert words.startswith("joint_1 is 2.4")


FIGURE = st.floats(-60, 60)


@settings(max_examples=300, deadline=None)
@given(
    wrench=st.lists(FIGURE, min_size=6, max_size=6),
    width=st.floats(0, 0.08),
    grip=st.floats(0, 60),
    elapsed=st.floats(0, 10),
    joint=st.floats(-2.79, 2.79),
    speed=st.floats(-1, 1),
    arrived=st.booleans(),
    touching=st.booleans(),
    order=st.permutations(range(9)),
)
def test_for_any_moment_there_is_one_reason_or_none(
    cell, make, wrench, width, grip, elapsed, joint, speed, arrived, touching, order
) -> None:
    traits = Traits.of(cell, "RIGHT-ARM")
    conditions = [
        (StopReason.COLLISION, p.BodyTouch()),
        (StopReason.JOINT_LIMIT, p.JointMarginBelow(0.1)),
        (StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0)),
        (StopReason.TORQUE_LIMIT, p.TorqueAbove(limit_nm=30.0)),
        (StopReason.CONTACT, p.ForceAbove(limit_n=5.0)),
        (StopReason.SLIP, p.GripForceBelow(20.0)),
        (StopReason.OBJECT_LOST, p.HandWidthBelow(0.018)),
        (StopReason.GOAL, p.GoalReached()),
        (StopReason.TIMEOUT, p.TimeAbove(5.0)),
    ]
    wanted = p.Primitive(
        id="C-1.1",
        performer="RIGHT-ARM",
        trajectory=p.HoldStill(),
        stop_functions=[make.stop(*conditions[n]) for n in order],
    )
    force, torque = math.dist(wrench[:3], (0, 0, 0)), math.dist(wrench[3:], (0, 0, 0))
    now = moment(
        elapsed_s=elapsed,
        joints=[joint, 1.0, -1.0, 0.0, 0.0, 0.0],
        velocities=[speed, 0.0, 0.0, 0.0, 0.0, 0.0],
        wrench=wrench,
        force_n=force,
        torque_nm=torque,
        width_m=width,
        grip_n=grip,
        arrived=(0.0, 0.002, "") if arrived else None,
        touch=lambda: "forearm touches SATELLITE" if touching else "",
    )
    true = [
        reason
        for reason, holds in (
            (StopReason.COLLISION, touching),
            (StopReason.JOINT_LIMIT, abs(joint) > traits.upper[0] - 0.1 and joint * speed > 0),
            (StopReason.FORCE_LIMIT, force > 30.0),
            (StopReason.TORQUE_LIMIT, torque > 30.0),
            (StopReason.CONTACT, force > 5.0),
            (StopReason.SLIP, grip < 20.0),
            (StopReason.OBJECT_LOST, width < 0.018),
            (StopReason.GOAL, arrived),
            (StopReason.TIMEOUT, elapsed > 5.0),
        )
        if holds
    ]
    found = stop_functions.first(stop_functions.compile_stops(wanted, traits), now)
    assert (None if found is None else found[0].reason) == min(true, key=lambda r: PRIORITY[r], default=None)
