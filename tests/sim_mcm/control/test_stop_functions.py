"""F: each predicate against its own moment, and one reason for any moment (R83, A21)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import PRIORITY, StopReason
from sim_mcm.arms.arm import Traits
from sim_mcm.control import stop_functions
from sim_mcm.control.stop_functions import Moment


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
        "arrived": None,
        "tcp": lambda: np.array([0.5, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0]),
        "touch": lambda: "",
        "commanded": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
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
    (p.TcpNear(point=[0.5, 0.0, 0.68], distance_m=0.03), {}, {"tcp": lambda: np.array([0.5, 0.1, 0.7, 0, 0, 0, 1])}),
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
