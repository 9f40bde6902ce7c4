"""F: each predicate against its own moment, and one reason for any moment (R83, A21)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import PRIORITY, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion import clearance, stop_functions
from rtc.subsystems.motion.arm import Near, Traits
from rtc.subsystems.motion.moment import Moment

HERE = np.array([0.5, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0])


def at(x: float, y: float, z: float) -> Callable[[], Array]:
    return lambda: np.array([x, y, z, 0.0, 0.0, 0.0, 1.0])


#: what a hand may hold: a bar that reaches 0.25 m below the tcp
BAR = [0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0, 0.02, 0.02, 0.3]


def moment(**changes: object) -> Moment:
    """A moment in which nothing is the matter."""
    figures = {
        "elapsed_s": 1.0,
        "joints": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
        "velocities": [0.0] * 6,
        "wrench": [0.0] * 6,
        "force_n": 0.0,
        "torque_nm": 0.0,
        "fingers": (0.01, 0.01),
        "finger_forces": (30.0, 30.0),
        "arrived": None,
        "tcp": lambda: HERE,
        "touch": lambda: "",
        "commanded": [0.0, 1.0, -1.0, 0.0, 0.0, 0.0],
        "commanded_tcp": lambda: HERE,
        "tcp_speed_m_s": lambda: 0.0,
        "near": lambda within_m: (),
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
    (p.ArmTouch(), {"arm_touch": lambda: "RIGHT-ARM forearm touches LEFT-ARM palm"}, {}),
    (p.BodyTouch(), {"touch": lambda: "forearm touches MACS-OLD"}, {}),
    (p.GripForceBelow(20.0), {"finger_forces": (19.0, 30.0)}, {"finger_forces": (21.0, 30.0)}),
    (p.HandWidthBelow(0.018), {"fingers": (0.0085, 0.0085)}, {"fingers": (0.0095, 0.0095)}),
    (p.TcpNear(point=[0.5, 0.0, 0.68], distance_m=0.03), {}, {"tcp": at(0.5, 0.1, 0.7)}),
    (p.TcpNear(point=[0.9, 0.9, 0.68], distance_m=0.03, axis=[0, 0, 1]), {}, {"tcp": at(0.9, 0.9, 0.72)}),
    (p.TcpFar(point=[0.5, 0.0, 0.7], distance_m=0.05), {"tcp": at(0.5, 0.04, 0.74)}, {"tcp": at(0.5, 0.03, 0.73)}),
    (
        p.TcpFar(point=[0.5, 0.0, 0.7], distance_m=0.05, axis=[0, 0, 1]),
        {"tcp": at(0.5, 0.0, 0.64)},
        {"tcp": at(0.9, 0.9, 0.7)},
    ),
    (p.TcpSpeedAbove(0.1), {"tcp_speed_m_s": lambda: 0.11}, {"tcp_speed_m_s": lambda: 0.09}),
    (p.GripForceAbove(40.0), {"finger_forces": (30.0, 41.0)}, {"finger_forces": (30.0, 39.0)}),
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


def turned(*rpy: float, x: float = 0.5, y: float = 0.0) -> Callable[[], Array]:
    return lambda: geometry.from_rpy((x, y, 0.7), rpy)


def beside(*, away_m: float, point: tuple[float, ...] = (0.5, 0.1, 0.7)) -> Callable[[float], Sequence[Near]]:
    near = Near(away_m, point, "forearm", "RACK-1 floor", (0.0, 1.0, 0.0), (0, 4))
    return lambda within_m: [near] if away_m < within_m else []


# (condition, moments in order that do not meet it, and one that then does)
SINCE_THE_START = [
    (p.TurnAbove(limit_rad=0.5), [turned(0, 0, 0), turned(0.4, 0, 0)], turned(0.4, 0, 0.4)),
    (p.TurnAbove(limit_rad=7.0, axis=[0, 0, 1]), [turned(0, 0, n) for n in range(8)], turned(0, 0, 7.1)),
    (p.TurnAbove(limit_rad=0.5, axis=[0, 0, 1]), [turned(0, 0, 0), turned(1, 0, 0)], turned(1, 0, -0.6)),
    (
        p.TurnAbove(limit_rad=3.0, axis=[0, 0, 1], point=[0.0, 0.0, 0.0]),
        [turned(0, 0, 0, x=math.cos(n / 2), y=math.sin(n / 2)) for n in range(7)],
        turned(0, 0, 0, x=math.cos(3.1), y=math.sin(3.1)),
    ),
]

RANGE = {"centre": [0.5, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0], "size_m": [0.2, 0.2, 0.4], "load": [BAR]}  # z 0.4 to 0.8
SINCE_THE_START += [
    (p.TcpOutside(**RANGE), [at(0.5, 0, 0.7), at(0.5, 0, 0.655)], at(0.5, 0, 0.64)),
    (p.TcpOutside(**RANGE), [at(0.5, 0, 0.6), at(0.5, 0, 0.598), at(0.5, 0, 0.7)], at(0.5, 0, 0.59)),  # begins outside
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
    (p.GripForceBelow(3.0, once_above=True), {"finger_forces": (4.0, 4.0)}, {"finger_forces": (2.0, 2.0)}),
    (p.TorqueBelow(limit_nm=1.0, axis=[1, 0, 0]), {"wrench": [0, 0, 0, 2.0, 0, 0]}, {"wrench": [0, 0, 0, 0, 5.0, 0]}),
]


@pytest.mark.parametrize(("when", "before", "after"), SINCE_THE_START, ids=lambda value: type(value).__name__)
def test_a_turn_is_counted_from_the_start(traits, make, when, before, after) -> None:
    stops = stop_functions.compile_stops(make.primitive(p.HoldStill(), make.stop(StopReason.HALT, when)), traits)
    assert [stop_functions.first(stops, moment(tcp=tcp)) for tcp in before] == [None] * len(before)
    found = stop_functions.first(stops, moment(tcp=after))
    assert found is not None
    assert found[0].when == when
    assert [type(value) for value in found[1]] == [float, float, str]  # numbers that a report can carry


def test_a_joint_is_watched_from_where_it_began(traits, make) -> None:
    when = p.JointTurnAbove(joint=1, limit_rad=0.2)
    stops = stop_functions.compile_stops(make.primitive(p.HoldStill(), make.stop(StopReason.HALT, when)), traits)
    for q in (1.0, 1.19, 0.81):
        assert stop_functions.first(stops, moment(joints=[0.0, q, -1.0, 0, 0, 0])) is None
    found = stop_functions.first(stops, moment(joints=[0.0, 0.79, -1.0, 0, 0, 0]))
    assert found is not None
    assert found[1][0] == pytest.approx(0.21)


def watched(make, traits, when: p.Predicate, *moments: dict[str, object]) -> list[bool]:
    """Whether the condition holds in the last tick of each moment; each lasts as long as the filter."""
    stops = stop_functions.compile_stops(make.primitive(p.HoldStill(), make.stop(StopReason.HALT, when)), traits)
    return [
        [stop_functions.first(stops, moment(**now)) is not None for _ in range(clearance.NEAR_TICKS)][-1]
        for now in moments
    ]


def test_a_body_that_comes_near_is_seen_and_one_that_was_near_may_only_get_farther(traits, make) -> None:
    when = p.ClearanceBelow(limit_m=0.03)
    far, close, closer = ({"near": beside(away_m=away_m)} for away_m in (0.04, 0.02, 0.019))
    assert watched(make, traits, when, far, close, far) == [False, True, False]
    assert watched(make, traits, when, close, close, far, close) == [False, False, False, True]
    assert watched(make, traits, when, close, closer, close) == [False, True, False]
    assert watched(make, traits, when, closer, close, closer) == [False, False, True]


def test_a_load_in_a_region_is_seen_within_some_ticks(traits, make) -> None:
    when = p.TcpInside(centre=[0.5, 0, 0.4, 0, 0, 0, 1], size_m=[0.2] * 3, load=[BAR])
    high, low = {"tcp": at(0.5, 0, 0.76)}, {"tcp": at(0.5, 0, 0.74)}
    ticks = stop_functions.LOAD_TICKS
    assert watched(make, traits, when, *[high] * ticks) == [False] * ticks
    assert watched(make, traits, when, *[high] * ticks, *[low] * ticks)[-1]


def test_what_was_near_is_one_body_of_several_parts(traits, make) -> None:
    when, wall = p.ClearanceBelow(limit_m=0.03), Near(0.02, HERE[:3], "palm", "RACK-1 wall", (0.0, 0.0, 1.0), (0, 6))
    moments = [wall, wall._replace(body="RACK-1 lip"), wall._replace(body="RACK-2 wall")]
    seen = [{"near": lambda within_m, one=one: [one]} for one in moments]
    assert watched(make, traits, when, *seen) == [False, False, True]


def test_a_body_that_may_come_near_is_left_out(traits, make) -> None:
    when = p.ClearanceBelow(limit_m=0.03, except_near=[[0.5, 0.0, 0.7, 0.2]])
    inside, outside = beside(away_m=0.02), beside(away_m=0.02, point=(0.5, 0.3, 0.7))
    assert watched(make, traits, when, {}, {"near": inside}, {"near": outside}) == [False, False, True]


@pytest.mark.parametrize(
    "bad",
    [
        p.JointTurnAbove(joint=6, limit_rad=0.1),
        p.JointTurnAbove(joint=-1, limit_rad=0.1),
        p.TurnAbove(limit_rad=math.nan),
        p.TurnAbove(limit_rad=1.0, axis=[0.0, 1.0]),
        p.ClearanceBelow(limit_m=math.inf),
        p.ClearanceBelow(limit_m=0.1, except_near=[[0.0, 0.0, 0.0, math.nan]]),
        # never true, or always
        p.ForceAbove(limit_n=-1.0),
        p.ForceAbove(limit_n=5.0, axis=[0.0, 0.0, 0.0]),
        p.TorqueAbove(limit_nm=1.0, axis=[0.0, 2.0, 0.0]),
        p.ForceBelow(limit_n=0.0),
        p.ForceBelow(limit_n=1.0, for_s=-0.1),
        p.TorqueBelow(limit_nm=0.0),
        p.GripForceBelow(0.0),
        p.HandWidthBelow(-0.001),
        p.TcpNear(point=[0.0] * 3, distance_m=0.0),
        p.ClearanceBelow(limit_m=0.0),
        p.TurnAbove(limit_rad=1.0, axis=[0.0, 0.0, 0.0]),
        p.TcpOutside(centre=[0.0] * 6 + [1.0], size_m=[1.0, -1.0, 1.0]),
        p.TcpInside(centre=[0.0] * 6 + [1.0], size_m=[1.0, 0.0, 1.0]),
    ],
)
def test_a_condition_that_no_arm_can_check_is_refused(traits, make, bad) -> None:
    with pytest.raises(ValueError, match=type(bad).__name__):
        stop_functions.compile_stops(make.primitive(p.HoldStill(), make.stop(StopReason.HALT, bad)), traits)


@pytest.mark.parametrize(
    "make_bad",
    [
        lambda: p.TurnAbove(limit_rad=1.0, point=[0.0, 0.0, 0.0]),
        lambda: p.ClearanceBelow(limit_m=0.1, except_near=[[0.0, 0.0, 0.0]]),
        lambda: p.TcpInside(centre=[0.0] * 6 + [1.0], size_m=[1.0] * 3, load=[[0.0] * 7]),
        lambda: p.ReportCondition(n=0, when=p.GoalReached()),
    ],
)
def test_a_condition_without_a_meaning_cannot_be_made(make_bad) -> None:
    with pytest.raises(ValueError, match=r"axis|ball|box|goal"):
        make_bad()


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


KINDS = set(p.Predicate.__args__)  # type: ignore[attr-defined]


def test_a_hand_that_was_closed_more_strongly_before_has_a_moment_to_yield(traits, make) -> None:
    wanted = make.primitive(p.HoldStill(), make.stop(StopReason.FORCE_LIMIT, p.GripForceAbove(40.0)))
    stops = stop_functions.compile_stops(wanted, traits)
    assert stop_functions.first(stops, moment(finger_forces=(45.0, 45.0), elapsed_s=0.001)) is None
    assert stop_functions.first(stops, moment(finger_forces=(45.0, 45.0), elapsed_s=0.3)) is not None
    assert stop_functions.first(stops, moment(finger_forces=(39.0, 39.0), elapsed_s=0.3)) is None


def test_every_predicate_of_the_contract_can_be_checked() -> None:
    assert set(stop_functions.CHECKS) == KINDS
    apart = {p.JointTurnAbove, p.ClearanceBelow, p.UnseenAbove}  # have tests of their own; the last is of cameras
    assert {type(row[0]) for row in (*ROWS, *FALLEN, *SINCE_THE_START)} | apart == KINDS


def test_every_predicate_and_its_filter_are_in_the_documentation() -> None:
    page = (Path(__file__).parents[3] / "docs" / "physics.md").read_text()
    missing = [kind.__struct_config__.tag for kind in KINDS if f"| `{kind.__struct_config__.tag}` |" not in page]
    assert missing == []


def test_of_any_two_reasons_one_comes_first_in_whatever_order_they_are_given(traits, make) -> None:
    """F is unambiguous by construction: every pair of reasons, both true, in both orders."""
    always = p.TimeAbove(0.0)
    for first, second in itertools.permutations(StopReason, 2):
        wanted = make.primitive(p.HoldStill(), make.stop(first, always), make.stop(second, always))
        found = stop_functions.first(stop_functions.compile_stops(wanted, traits), moment())
        assert found is not None
        assert found[0].reason is min(first, second, key=PRIORITY.__getitem__)
    assert sorted(PRIORITY.values()) == list(range(len(StopReason)))


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
        fingers=(0.5 * width, 0.5 * width),
        finger_forces=(grip, grip),
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
