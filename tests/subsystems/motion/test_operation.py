"""The operator moves an arm: the stream, what is not granted, DONE and CANNOT; also with fuzzed streams."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.modes import Mode
from rtc.subsystems.motion.operation import LOST_S, STALE_S
from rtc.subsystems.motion.shared_way import SharedWay

ME, ANOTHER = b"me", b"another"
GRANT = "C-7.1"


class Operator:
    """An operator with a hand controller at 50 Hz, and the operated arm; both run by one clock."""

    def __init__(self, rig, make, **granted) -> None:
        self.rig, self.executor, self.now_s = rig, rig.executor, 100.0
        self.start = rig.arm.tcp_pose(rig.home)
        granted = {"request": "move it", "speed_m_s": 0.1, "turn_rad_s": 0.5} | granted
        rig.accept(make.primitive(p.TeleopMotion(**granted), id=GRANT, limit_s=3600.0))

    def wanted(self, **changed) -> m.Operate:
        given = {"primitive": GRANT, "operator": "ADA", "seen_at_s": self.now_s, "hold": True}
        return m.Operate(**given | changed)

    def send(self, caller: bytes = ME, **changed) -> str:
        return self.executor.operate(self.wanted(**changed), caller, self.now_s)

    def tick(self, ticks: int) -> list:
        sent = []
        for _ in range(ticks):
            sent += self.executor.tick(self.now_s)
            self.rig.arm.move_hand()
            self.now_s += TICK_S
        return sent

    def drive(self, seconds: float, **changed) -> list:
        sent = []
        for _ in range(round(seconds / 0.02)):
            assert self.send(**changed) == ""
            sent += self.tick(20)
        return sent

    def answer(self, done: bool = True, why: str = "") -> str:
        return self.executor.answer(m.OperatorAnswer(primitive=GRANT, done=done, why=why))

    @property
    def moved(self) -> np.ndarray:
        return self.rig.arm.tcp_pose(self.executor.command[0])[:3] - self.start[:3]

    @property
    def fastest_rad_s(self) -> float:
        return max(map(abs, self.executor.command[1]))


@pytest.fixture
def hands_on(rig, make):
    return lambda **granted: Operator(rig, make, **granted)


def up(m_s: float = 0.05) -> list[float]:
    return [0.0, 0.0, m_s, 0.0, 0.0, 0.0]


def test_the_tcp_follows_a_twist_while_the_deadman_is_held(hands_on) -> None:
    it = hands_on()
    it.drive(1.0, twist=up())
    assert it.moved == pytest.approx([0.0, 0.0, 0.05], abs=0.004)
    it.drive(0.1, hold=False, twist=up())
    stood = it.moved
    it.drive(0.2, hold=False, twist=up())
    assert it.moved == pytest.approx(stood)


def test_a_twist_in_tool_axes_goes_along_the_tool(hands_on) -> None:
    it = hands_on()
    it.drive(0.5, twist=up(), frame="tool")
    ahead = np.linalg.norm(it.moved)
    assert it.moved / ahead == pytest.approx(geometry.rotate(it.start, [0.0, 0.0, 1.0]), abs=0.05)


def test_a_silent_stream_stops_the_arm_within_100_ms(hands_on) -> None:
    it = hands_on()
    it.drive(0.5, twist=up(0.1))
    assert it.fastest_rad_s > 0.05
    it.tick(80)  # the latest message is 20 ms old
    assert it.fastest_rad_s == 0.0


@pytest.mark.parametrize(
    "changed",
    [
        {"primitive": "C-6.1"},
        {"seen_at_s": 100.0 - STALE_S - 0.01},
        {"seen_at_s": 101.0},
        {"seen_at_s": math.nan},
        {"twist": [1.7e308, -1.7e308, 1.7e308, 0.0, 0.0, 0.0], "frame": "tool"},  # it becomes nan in world axes
        {"twist": [0.0, 0.0, 0.0, -1001.0, 0.0, 0.0]},
        {"twist": [math.nan] * 6},
        {"twist": [math.inf, 0, 0, 0, 0, 0]},
        {"hand": "close"},
        {"turn": 0.5},
    ],
)
def test_what_is_not_granted_or_not_new_does_nothing(hands_on, changed) -> None:
    it = hands_on()
    before = it.rig.arm.hand
    assert it.send(**{"twist": up()} | changed) != ""
    it.tick(50)
    assert it.moved == pytest.approx([0.0] * 3, abs=1e-12)
    assert it.rig.arm.hand == before


def test_two_operators_never_share_an_arm(hands_on) -> None:
    it = hands_on()
    assert it.send(twist=up()) == ""
    assert "ADA" in it.send(ANOTHER, operator="BOB")
    assert it.send(hold=False) == ""
    assert it.send(ANOTHER, operator="BOB", twist=up()) == ""
    assert "BOB" in it.send()


def test_an_operator_who_is_lost_gives_the_arm_up(hands_on) -> None:
    it = hands_on()
    assert it.send(twist=up()) == ""
    assert it.executor.operated.look().operator == "ADA"
    it.tick(round(STALE_S / TICK_S) + 2)
    assert it.executor.operated.look().operator == ""
    assert it.send(ANOTHER, operator="BOB", twist=up()) == ""


def test_the_operator_does_not_leave_the_neighbourhood(hands_on, rig) -> None:
    centre = rig.arm.tcp_pose(rig.home)[:3].tolist()
    it = hands_on(centre=centre, radius_m=0.03)
    it.drive(2.0, twist=up(0.1))
    assert 0.025 < np.linalg.norm(it.moved) < 0.0301
    assert it.executor.operated.look().cut
    it.drive(0.3, twist=up(-0.1))
    assert np.linalg.norm(it.moved) < 0.02


def test_stop_functions_are_watched(hands_on, rig, make) -> None:
    wanted = p.TeleopMotion(request="move it", speed_m_s=0.1, turn_rad_s=0.5)
    guarded = make.primitive(wanted, make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=5.0)), id="C-7.2")
    it = hands_on()
    it.executor.halt()
    it.tick(300)
    rig.accept(guarded)
    it.drive(0.3, primitive="C-7.2", twist=up())
    rig.arm.wrench = [0.0, 0.0, 9.0, 0.0, 0.0, 0.0]
    sent = it.tick(1500)
    assert [s.reason for s in sent if isinstance(s, m.EndReport)] == [StopReason.FORCE_LIMIT]
    assert it.send(primitive="C-7.2", twist=up()) != ""  # its grant has ended


def test_done_is_believed_only_when_the_measurements_prove_it(hands_on, rig) -> None:
    place = rig.arm.tcp_pose(rig.home)[:3] + np.array([0.0, 0.0, 0.06])
    it = hands_on(centre=place.tolist(), radius_m=0.15, done_m=0.01)
    assert "60 mm" in it.answer()
    it.drive(1.2, twist=up())
    assert "moves" in it.answer()
    it.send(hold=False)
    it.tick(100)
    assert it.answer() == ""
    [report] = [s for s in it.tick(100) if isinstance(s, m.EndReport)]
    assert report.reason is StopReason.GOAL  # that of its F
    assert report.tcp_pose[2] == pytest.approx(place[2], abs=0.01)


def test_a_grip_is_proved_by_the_fingers(hands_on, rig) -> None:
    it = hands_on(hand=True, grip_n=40.0, done_grip_n=20.0)
    it.drive(0.3, hand="close")
    it.send(hold=False)
    it.tick(50)
    assert rig.arm.hand.force_n == 40.0
    assert "0.0 N" in it.answer()
    rig.arm.forces = (30.0, 30.0)
    it.tick(50)
    assert it.answer() == ""


def test_cannot_ends_the_primitive_at_once(hands_on) -> None:
    it = hands_on(centre=[0.0, 0.0, 0.0], radius_m=3.0, done_m=0.001)
    it.drive(0.2, twist=up())
    assert it.answer(done=False, why="it is stuck") == ""
    [report] = [s for s in it.tick(1500) if isinstance(s, m.EndReport)]
    assert (report.reason, report.message) == (StopReason.OPERATOR_CANNOT, "it is stuck")  # wording: the operator's


def test_a_pause_holds_the_arm_and_its_clock(hands_on) -> None:
    it = hands_on()
    it.drive(0.2, twist=up())
    it.executor.pace(True)
    paced = [s.paused for s in it.tick(200) if isinstance(s, m.PauseChanged)]
    assert "paused" in it.send(twist=up())
    it.executor.pace(False)
    paced += [s.paused for s in it.tick(5) if isinstance(s, m.PauseChanged)]
    assert paced == [True, False]
    it.drive(0.2, twist=up())


def test_a_halt_stops_the_operator(hands_on) -> None:
    it = hands_on()
    it.drive(0.4, twist=up(0.1))
    assert it.executor.halt()
    it.send(twist=up(0.1))
    [report] = [s for s in it.tick(1500) if isinstance(s, m.EndReport)]
    assert report.reason is StopReason.HALT
    assert it.executor.state is Mode.HOLDING


BRAKING_S = 0.042
NUMBERS = st.floats(allow_nan=True, allow_infinity=True, width=32) | st.floats(-1.0, 1.0)
MESSAGES = st.fixed_dictionaries(
    {
        "twist": st.lists(NUMBERS, min_size=6, max_size=6),
        "hold": st.booleans(),
        "frame": st.sampled_from(["tool", "world"]),
        "hand": st.sampled_from(["", "close", "open"]),
        "primitive": st.sampled_from([GRANT, GRANT, GRANT, "C-6.1", ""]),
        "age_s": st.sampled_from([0.0, 0.0, 0.0, 0.1, 0.3, -1.0]),
        "caller": st.sampled_from([ME, ME, ANOTHER]),
        "after": st.sampled_from([5, 20, 90]),
    }
)


@settings(max_examples=20, deadline=None)
@given(st.lists(MESSAGES, min_size=1, max_size=6))
def test_no_stream_moves_the_arm_beyond_its_grant(rig_of, make, stream) -> None:
    rig = rig_of()
    centre = rig.arm.tcp_pose(rig.home)[:3].tolist()
    it = Operator(rig, make, centre=centre, radius_m=0.02)
    before, may_move_until_s = rig.arm.hand, -math.inf
    for one in stream:
        caller, after, age_s = one.pop("caller"), one.pop("after"), one.pop("age_s")
        counts = it.send(caller, seen_at_s=it.now_s - age_s, **one) == ""
        if counts:
            may_move_until_s = it.now_s + BRAKING_S + (LOST_S if one["hold"] else 0.0)
        for _ in range(after):
            it.tick(1)
            assert np.linalg.norm(it.moved) < 0.0201
            assert it.fastest_rad_s < 0.5
            assert it.fastest_rad_s == 0.0 or it.now_s <= may_move_until_s
    assert rig.arm.hand == before
    assert isinstance(rig.executor, Executor)


# --- shared with the program -----------------------------------------------------------------------------

WRIST, POSITION, TOOL_Z = [3, 4, 5], [0, 1, 2], [2]


@pytest.fixture
def way(rig, make):
    """A path of 2 s that moves and turns the tcp."""
    return make.joint_path(rig.home, [q + 0.12 for q in rig.home], 2.0)


def off_way(it: Operator, pose) -> tuple[float, float]:
    here = it.rig.arm.tcp_pose(it.executor.command[0])
    return math.dist(here[:3], pose[:3]), geometry.angle(here, pose)


def test_the_place_is_the_programs_and_the_attitude_the_operators(hands_on, way) -> None:
    it = hands_on(along=way, operator_axes=WRIST, done_m=0.005)
    end = it.rig.arm.tcp_pose(way.positions[-1])
    assert "is near enough" in it.answer()
    it.drive(1.0, twist=[0.1, 0.1, 0.1, 0.0, 0.0, 0.3])  # the linear twist does nothing
    it.drive(4.0, twist=[0.0] * 6)
    away_m, _ = off_way(it, end)
    here = it.rig.arm.tcp_pose(it.executor.command[0])
    assert away_m < 0.001
    assert geometry.rotation_vector(it.start, here) == pytest.approx([0, 0, 0.3], abs=0.03)
    it.drive(0.1, hold=False)
    assert it.answer() == ""


def test_the_attitude_is_the_programs_and_the_place_the_operators(hands_on, way) -> None:
    it = hands_on(along=way, operator_axes=POSITION, done_m=0.005)
    it.drive(1.0, twist=[0.0, 0.0, 0.03, 0.5, 0.5, 0.5])
    it.drive(4.0, twist=[0.0] * 6)
    _, turned_rad = off_way(it, it.rig.arm.tcp_pose(way.positions[-1]))
    assert turned_rad < 0.005
    assert it.moved == pytest.approx([0.0, 0.0, 0.03], abs=0.004)
    it.drive(0.1, hold=False)
    assert it.answer() == ""


def test_one_axis_of_the_tool_is_the_operators(hands_on, way) -> None:
    it = hands_on(along=way, operator_axes=TOOL_Z, done_m=0.005)
    end = it.rig.arm.tcp_pose(way.positions[-1])
    it.drive(6.0, twist=[0.0] * 6)
    _, turned_rad = off_way(it, end)
    here = it.rig.arm.tcp_pose(it.executor.command[0])
    assert turned_rad < 0.005
    assert np.abs(geometry.relative(here, end)[:2]) == pytest.approx([0.0, 0.0], abs=0.001)


def test_the_program_moves_only_while_the_deadman_is_held(hands_on, way) -> None:
    it = hands_on(along=way, operator_axes=WRIST, done_m=0.005)
    it.tick(500)
    assert np.linalg.norm(it.moved) == 0.0
    it.drive(0.6, twist=[0.0] * 6)
    assert it.fastest_rad_s > 0.02
    it.tick(80)  # the stream is silent
    assert it.fastest_rad_s == 0.0
    stood = it.moved
    it.drive(0.5, hold=False)
    assert it.moved == pytest.approx(stood)
    it.drive(6.0, twist=[0.0] * 6)
    assert off_way(it, it.rig.arm.tcp_pose(way.positions[-1]))[0] < 0.001


def test_a_path_that_waits_for_the_arm_says_so(rig, way) -> None:
    shared, stuck = SharedWay(way, WRIST, rig.arm.tcp_pose), rig.arm.tcp_pose(rig.home)
    shared.twist(stuck, [0.0] * 6)
    assert shared.waits_for == ""
    wanted = [shared.twist(stuck, [0.0] * 6) for _ in range(3000)]  # an arm that cannot follow
    assert shared.waits_for
    assert wanted[-1] == pytest.approx(wanted[-100], abs=1e-3)  # it does not go on


def test_a_path_that_waits_says_which_way(rig, make) -> None:
    """The wrist turns by 60 degrees on the path, and is held as it is."""
    turned = [*rig.home[:-1], rig.home[-1] + 1.0]
    shared, stuck = (
        SharedWay(make.joint_path(rig.home, turned, 3.0), WRIST, rig.arm.tcp_pose),
        rig.arm.tcp_pose(rig.home),
    )
    aside = [*stuck[:3] + np.array([0.02, 0.0, 0.0]), *stuck[3:]]
    for _ in range(5000):
        shared.twist(stuck, [0.0] * 6)
    assert shared.towards == []  # of the operator's axes alone it is not behind
    for _ in range(20):
        shared.twist(np.array(aside), [0.0] * 6)
    aside[0] = stuck[0] + 0.006  # less than it waits for on its way; at its end nothing else brings the arm nearer
    for _ in range(20):
        shared.twist(np.array(aside), [0.0] * 6)
    about = geometry.rotation_vector(stuck, rig.arm.tcp_pose(turned))
    assert shared.towards == pytest.approx([0.0, 0.0, 0.0, *about], abs=0.02)
    sign = "-" if geometry.relative(stuck, rig.arm.tcp_pose(turned))[5] < 0.0 else ""
    assert f": turn about {sign}TOOL-Z by 57.3 deg" in shared.waits_for


@pytest.mark.parametrize("granted", [{"operator_axes": WRIST}, {"operator_axes": [7]}])
def test_a_shared_motion_needs_its_path_and_its_axes(granted) -> None:
    with pytest.raises(ValueError, match=r"path|axes|<= 5"):
        msgspec.convert({"request": "turn it", "speed_m_s": 0.1, "turn_rad_s": 0.5} | granted, p.TeleopMotion)


def test_a_path_that_begins_elsewhere_is_refused(hands_on, rig, make) -> None:
    far = make.joint_path([q + 0.3 for q in rig.home], rig.home, 2.0)
    shared = p.TeleopMotion(request="turn it", speed_m_s=0.1, turn_rad_s=0.5, along=far, operator_axes=WRIST)
    ended = rig.accept(make.primitive(shared, id=GRANT))
    assert isinstance(ended, m.EndReport)
    assert ended.reason is StopReason.REFUSED
