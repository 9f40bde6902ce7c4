"""One arm, one primitive, one reason: how it ends, and what it reports."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import PRIORITY, Reflex, StopReason
from rtc.spatial import geometry
from rtc.subsystems.motion import profiles
from rtc.subsystems.motion.arm import TICK_S, HandCommand, Sample
from rtc.subsystems.motion.modes import MOVING, Mode
from tests.subsystems.motion.conftest import SteeredArm

# --- to the goal -----------------------------------------------------------------------------------------


def test_a_motion_to_its_goal_ends_with_one_full_report(rig) -> None:
    assert rig.accept(rig.swing()) == m.Started(primitive="C-7.1", at_s=0.0)

    report = rig.until_end()

    assert (report.primitive, report.performer, report.reason) == ("C-7.1", "RIGHT-ARM", StopReason.GOAL)
    assert report.joints == pytest.approx(rig.away, abs=1e-9)
    assert report.tcp_pose == pytest.approx(rig.arm.tcp_pose(rig.away).tolist())
    assert report.duration_s == pytest.approx(1.0, abs=0.015)
    assert report.trip_pose is not None
    assert report.limit is not None
    assert report.hand_width_m == pytest.approx(0.08)
    assert rig.executor.state is Mode.HOLDING
    assert [message for message in rig.tick(1000) if isinstance(message, m.EndReport)] == []


def test_a_report_states_how_long_the_arm_has_moved(rig, make) -> None:
    rig.accept(rig.swing())
    assert rig.until_end().moved_s == pytest.approx(1.0, abs=0.005)

    rig.accept(make.primitive(p.HoldStill(duration_s=0.2), id="C-7.2"))
    rested = rig.until_end()
    assert (rested.duration_s, rested.moved_s) == (pytest.approx(0.2, abs=0.015), 0.0)


def test_the_goal_waits_until_the_arm_is_there(rig) -> None:
    rig.arm.lag = 0.05  # a servo that lags behind, further than one that leans on something
    rig.accept(rig.swing(limit_s=2.0))
    assert rig.until_end().reason is StopReason.TIMEOUT


def test_a_small_difference_at_the_start_is_worked_off_without_a_jump(rig, make) -> None:
    start = [q + 0.005 for q in rig.home]
    rig.accept(make.primitive(make.joint_path(start, rig.away, 1.0)))

    report = rig.until_end()

    assert report.reason is StopReason.GOAL
    assert report.joints == pytest.approx(rig.away, abs=1e-9)
    steps = np.abs(np.diff([rig.home, *[motion[0] for motion in rig.arm.commands]], axis=0))
    assert steps.max() < 1.1 * 1.875 * 0.5 * TICK_S


def test_an_arm_that_leans_on_something_at_the_goal_has_arrived(rig) -> None:
    rig.arm.lag = 0.01  # a wall keeps it so far away
    rig.accept(rig.swing(limit_s=2.0))
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.measured == pytest.approx(0.01)  # and the report says how far it is


def _beside(rig, aside) -> None:
    """The first joint is measured beside its command; `aside`: joint (rad), tick -> joint (rad)."""
    read, ticks = rig.arm.read, [0]

    def measured():
        ticks[0] += 1
        sample = read()
        sample.joints = [aside(sample.joints[0], ticks[0]), *sample.joints[1:]]
        return sample

    rig.arm.read = measured


def test_an_arm_that_bears_a_load_at_its_goal_ends_as_soon_as_it_rests(rig) -> None:
    """Its outcome waited for a command that a joint under load never reaches: a second after the goal."""
    _beside(rig, lambda joint, tick: min(joint, rig.away[0] - 0.003))
    rig.accept(rig.swing(limit_s=3.0))
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.duration_s < 1.35
    assert report.joints[0] == pytest.approx(rig.away[0] - 0.003)


def test_an_arm_that_swings_beside_its_command_is_not_at_rest_where_it_turns(rig) -> None:
    """Two Hz, from 10 mrad down to 0.2 mrad in 0.9 s."""

    def swinging(joint: float, tick: int) -> float:
        return joint + 0.005 + 0.005 * np.exp(-3.5e-3 * max(0, tick - 400)) * np.cos(4e-3 * np.pi * tick)

    _beside(rig, swinging)
    rig.accept(rig.swing(limit_s=0.4))
    report = rig.until_end()
    assert report.reason is StopReason.TIMEOUT
    assert report.duration_s > 1.0


@pytest.mark.parametrize(("share", "reason"), [(1.1, StopReason.GOAL), (0.9, StopReason.TIMEOUT)])
def test_a_compliant_arm_has_arrived_as_near_as_its_step_allows(rig, make, share, reason) -> None:
    """The friction of a stiff hinge stretches its spring, and turns a joint by more than one that leans may be off."""
    soft = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[600.0] * 3 + [20.0] * 3))
    short = [rig.away[0] - 0.05, *rig.away[1:]]
    _beside(rig, lambda joint, tick: min(joint, short[0]))
    within_m = share * geometry.distance(rig.arm.tcp_pose(rig.away), rig.arm.tcp_pose(short))
    goal = make.stop(StopReason.GOAL, p.GoalReached(within_m))
    rig.accept(make.primitive(make.joint_path(rig.home, rig.away, 1.0), goal, control_law=soft, limit_s=2.0))
    assert rig.until_end().reason is reason


def test_hold_still_for_a_time_and_for_ever(rig, make) -> None:
    rig.accept(make.primitive(p.HoldStill(duration_s=0.2)))
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.duration_s == pytest.approx(0.2, abs=0.015)

    rig.accept(make.primitive(p.HoldStill(), id="C-7.2", limit_s=0.5))
    assert rig.until_end().reason is StopReason.TIMEOUT


def test_progress_is_reported_at_its_period_and_only_if_asked(rig) -> None:
    rig.accept(rig.swing(reporting=p.Reporting(every_s=0.1)))
    rig.until_end()
    assert sum(isinstance(message, m.ProgressReport) for message in rig.sent) == 10

    rig.sent.clear()
    back = rig.executor.command[0]
    rig.home, rig.away = back, rig.home
    rig.accept(rig.swing(id="C-7.2", duration_s=3.0))
    rig.until_end()
    assert len(rig.sent) == 2  # Started and the end, however long it takes (R57)


def conditions(*when: p.Predicate) -> p.Reporting:
    return p.Reporting(when=[p.ReportCondition(n=n, when=predicate) for n, predicate in enumerate(when)])


def test_a_condition_is_reported_once_and_stops_nothing(rig) -> None:
    rig.accept(rig.swing(reporting=conditions(p.ForceAbove(limit_n=5.0), p.TimeAbove(0.4), p.ForceAbove(limit_n=50.0))))
    rig.tick(100)
    for force in (6.0, 0.0, 7.0, 0.0):
        rig.arm.wrench[0] = force
        rig.tick(50)
    assert rig.until_end().reason is StopReason.GOAL

    reports = [sent for sent in rig.sent if isinstance(sent, m.ProgressReport)]
    assert [(one.condition, one.limit) for one in reports] == [(0, 5.0), (1, 0.4)]
    assert (reports[0].measured, reports[0].reading.wrench[0]) == (6.0, 6.0)


def test_a_condition_of_two_predicates_is_reported_once(rig) -> None:
    both = [p.ReportCondition(n=0, when=p.TimeAbove(limit_s)) for limit_s in (0.1, 0.2)]
    rig.accept(rig.swing(reporting=p.Reporting(when=both)))
    rig.until_end()
    assert sum(isinstance(sent, m.ProgressReport) for sent in rig.sent) == 1


def test_what_stops_a_motion_is_reported_before_its_end(rig, make) -> None:
    limit = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=5.0))
    rig.accept(rig.swing(limit, reporting=conditions(p.ForceAbove(limit_n=5.0))))
    rig.tick(100)
    rig.arm.wrench[0] = 6.0
    rig.until_end()
    assert [type(sent) for sent in rig.sent] == [m.Started, m.ProgressReport, m.EndReport]


# --- stopping --------------------------------------------------------------------------------------------


def _feel(make, reflex: Reflex = Reflex.STOP, back_off_m: float = 0.0) -> p.StopFunction:
    return make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0), reflex, back_off_m)


@pytest.mark.parametrize("quiet_ticks", [1, 500], ids=["at the start", "in the middle"])
def test_a_force_of_one_tick_ends_the_primitive_and_the_report_has_its_value(rig, make, quiet_ticks) -> None:
    """A rigid body is often felt for one tick alone."""
    rig.accept(rig.swing(make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0))))
    rig.tick(quiet_ticks)
    rig.arm.wrench = [0.0, 0.0, -30.5, 0.0, 0.0, 0.0]
    rig.tick(1)
    rig.arm.wrench = [0.0] * 6
    report = rig.until_end()
    assert report.reason is StopReason.FORCE_LIMIT
    assert (report.measured, report.limit) == (pytest.approx(30.5), 30.0)
    assert report.peak_force_n == pytest.approx(30.5)


def _speed(rig) -> float:
    return abs(rig.arm.commands[-1][1][0])


def test_the_tick_that_feels_the_contact_already_brakes(rig, make) -> None:
    rig.accept(rig.swing(_feel(make)))
    rig.tick(500)
    before = _speed(rig)

    rig.arm.wrench = [0.0, 0.0, -6.0, 0.0, 0.0, 0.0]
    rig.tick(1)

    assert rig.executor.state is Mode.STOPPING
    assert _speed(rig) < before
    report = rig.until_end()
    assert report.reason is StopReason.CONTACT
    assert (report.measured, report.limit) == (pytest.approx(6.0), 5.0)
    assert report.trip_wrench == pytest.approx([0.0, 0.0, -6.0, 0.0, 0.0, 0.0])
    assert report.trip_pose is not None
    assert report.peak_force_n == pytest.approx(6.0)
    assert report.joints != rig.away


class PushedArm(SteeredArm):
    """A spring pushes the first joint towards `free_rad`; the servo lets it go 0.6 of the way."""

    free_rad: float | None = None

    def read(self) -> Sample:
        sample = super().read()
        if self.free_rad is None:
            return sample
        first, *rest = sample.joints
        return msgspec.structs.replace(sample, joints=[first + 0.6 * (self.free_rad - first), *rest])


def test_an_arm_that_something_springy_pushes_away_can_begin_from_where_it_reports(rig, make, cell) -> None:
    """Otherwise every next path would begin too far from the command, and be refused."""
    pushed = PushedArm(cell)
    rig.arm = rig.executor.arm = pushed
    rig.accept(rig.swing(_feel(make)))
    rig.tick(500)

    pushed.wrench[0] = 6.0
    pushed.free_rad = pushed.motion[0][0] - 0.05
    report = rig.until_end()

    assert report.reason is StopReason.CONTACT
    begun = rig.accept(make.primitive(make.joint_path(report.joints, rig.home, 1.0), id="C-7.2"))
    assert isinstance(begun, m.Started), begun


@pytest.mark.parametrize("at_tick", [1, 40, 250, 500, 777, 960, 995])
def test_every_stop_keeps_its_limits_of_acceleration_and_jerk(rig, make, at_tick: int) -> None:
    rig.accept(rig.swing(_feel(make)))
    rig.tick(at_tick)
    first = len(rig.arm.commands)
    rig.arm.wrench = [9.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.until_end()

    states = np.array([rig.arm.commands[k] for k in range(first - 1, len(rig.arm.commands))])
    q, v, a = states[:, 0], states[:, 1], states[:, 2]
    worst = max(profiles.STOP_ACCELERATION_RAD_S2, np.abs(a[0]).max())
    assert np.abs(a).max() <= worst + 1e-6
    assert np.abs(np.diff(a, axis=0)).max() / TICK_S <= profiles.STOP_JERK_RAD_S3 * 1.001
    assert np.abs(np.diff(q, axis=0) / TICK_S - v[1:]).max() < 0.5 * (worst + 1e-9) * TICK_S * 1.01
    assert np.all(v[-1] == 0.0)
    assert np.all(a[-1] == 0.0)


def test_thresholds_are_masked_while_stopping(rig, make) -> None:
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=20.0))
    rig.accept(rig.swing(_feel(make), guard))
    rig.tick(500)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(1)
    rig.arm.wrench = [32.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # the hand's own inertia

    report = rig.until_end()

    assert report.reason is StopReason.CONTACT
    assert report.peak_force_n == pytest.approx(32.0)  # but it is reported


def test_backing_off_returns_along_the_way_it_came(rig, make) -> None:
    rig.accept(rig.swing(_feel(make, Reflex.BACK_OFF, 0.05)))
    rig.tick(600)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(1)
    rig.arm.wrench = [0.0] * 6

    report = rig.until_end()

    assert report.reason is StopReason.CONTACT
    reached = np.array(report.trip_pose[:3])
    radius = np.linalg.norm(reached[:2] - [0.0, -0.45])
    turned = np.array(report.joints) - np.array(rig.home)
    assert np.linalg.norm(np.array(report.tcp_pose[:3]) - reached) == pytest.approx(0.05, abs=0.002)
    assert turned[0] == pytest.approx(_trip_angle(rig, report) - 0.05 / radius, abs=0.002)
    assert np.abs(turned[1:]).max() < 1e-9


def _trip_angle(rig, report: m.EndReport) -> float:
    begin, trip = rig.arm.tcp_pose(rig.home), report.trip_pose
    return float(np.arctan2(trip[1] + 0.45, trip[0]) - np.arctan2(begin[1] + 0.45, begin[0]))


def test_backing_off_goes_no_farther_than_where_it_began(rig, make) -> None:
    rig.accept(rig.swing(_feel(make, Reflex.BACK_OFF, 5.0)))
    rig.tick(400)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert rig.until_end().joints == pytest.approx(rig.home, abs=1e-6)


def test_an_arm_that_meets_something_while_it_backs_off_stops_there(rig, make) -> None:
    limit = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0))
    rig.accept(rig.swing(_feel(make, Reflex.BACK_OFF, 0.20), limit))
    rig.tick(600)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(300)
    assert rig.executor.state is Mode.RETREATING
    rig.tick(500)
    rig.arm.wrench = [-31.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    report = rig.until_end()

    assert report.reason is StopReason.CONTACT
    assert report.reflex is Reflex.STOP
    assert "force_limit" in report.message  # wording: what stopped the reflex
    backed_m = np.linalg.norm(np.array(report.tcp_pose[:3]) - report.trip_pose[:3])
    assert 0.005 < backed_m < 0.05
    assert report.peak_force_n == 31.0


def test_what_the_arm_backs_away_from_does_not_stop_its_retreat(rig, make) -> None:
    limit = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0), Reflex.BACK_OFF, 0.05)
    rig.accept(rig.swing(limit))
    rig.tick(600)
    rig.arm.wrench = [31.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(400)
    rig.arm.wrench = [0.0] * 6
    report = rig.until_end()
    assert report.reflex is Reflex.BACK_OFF
    assert np.linalg.norm(np.array(report.tcp_pose[:3]) - report.trip_pose[:3]) == pytest.approx(0.05, abs=0.003)


def test_releasing_opens_the_hand_after_the_stop(rig, make) -> None:
    rig.arm.hand = HandCommand(0.02, 30.0, 0.05)
    rig.arm.width = 0.02
    rig.accept(rig.swing(_feel(make, Reflex.RELEASE)))
    rig.tick(500)
    rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(1)
    assert rig.executor.state is Mode.STOPPING
    assert rig.arm.width == pytest.approx(0.02)  # not while it moves

    report = rig.until_end()

    assert report.reason is StopReason.CONTACT
    assert report.hand_width_m == pytest.approx(0.08, abs=0.001)


def test_the_wrench_is_reported_less_the_bias_at_the_start(rig, make) -> None:
    rig.arm.wrench = [0.0, 0.0, 4.0, 0.0, 0.0, 0.0]
    rig.accept(rig.swing(_feel(make)))
    rig.tick(300)
    rig.arm.wrench = [0.0, 0.0, 8.0, 0.0, 0.0, 0.0]  # 4 N more than at the start: below the limit
    rig.tick(10)
    assert rig.executor.state is Mode.EXECUTING
    rig.arm.wrench = [0.0, 0.0, 9.5, 0.0, 0.0, 0.0]
    assert rig.until_end().trip_wrench[2] == pytest.approx(5.5)


# --- which reason ----------------------------------------------------------------------------------------


def test_of_all_conditions_that_hold_in_one_tick_the_first_by_priority_wins(cell, make) -> None:
    by_reason = {
        StopReason.COLLISION: p.BodyTouch(),
        StopReason.FORCE_LIMIT: p.ForceAbove(limit_n=20.0),
        StopReason.TORQUE_LIMIT: p.TorqueAbove(limit_nm=2.0),
        StopReason.CONTACT: p.ForceAbove(limit_n=5.0),
        StopReason.SLIP: p.GripForceBelow(20.0),
        StopReason.OBJECT_LOST: p.HandWidthBelow(0.018),
    }
    order = sorted(by_reason, key=lambda reason: PRIORITY[reason])
    for n, expected in enumerate(order):
        fresh = make.Rig(cell)
        stops = [make.stop(reason, by_reason[reason]) for reason in reversed(order[n:])]
        fresh.arm.width, fresh.arm.forces = 0.02, (30.0, 30.0)
        fresh.arm.hand = HandCommand(0.02, 30.0, 0.05)
        fresh.accept(fresh.swing(*stops))
        fresh.tick(100)
        fresh.arm.wrench = [25.0, 0.0, 0.0, 0.0, 3.0, 0.0]
        fresh.arm.leaning = {"forearm touches RACK-1 floor": 3.0}
        fresh.arm.width, fresh.arm.forces = 0.01, (0.0, 0.0)
        fresh.arm.hand = HandCommand(0.01, 30.0, 0.05)
        report = fresh.until_end()
        assert report.reason is expected


def test_a_collision_names_the_bodies(rig, make) -> None:
    rig.accept(rig.swing(make.stop(StopReason.COLLISION, p.BodyTouch())))
    rig.tick(200)
    rig.arm.leaning = {"forearm touches RACK-1 floor": 3.0}
    assert rig.until_end().message == "forearm touches RACK-1 floor"  # wording: the bodies


def test_an_arm_may_move_away_from_what_it_touched_at_the_start_but_not_into_it(rig, make) -> None:
    floor, wall = "forearm touches RACK-1 floor", "forearm touches RACK-1 left-wall"
    collision = make.stop(StopReason.COLLISION, p.BodyTouch())
    rig.arm.leaning = {floor: 4.0}
    rig.accept(rig.swing(collision, duration_s=4.0))
    rig.tick(100)
    rig.arm.leaning = {floor: 15.0}
    rig.tick(100)
    assert rig.executor.state is Mode.EXECUTING
    rig.arm.leaning = {floor: 4.0, wall: 0.1}  # something new
    assert rig.until_end().message == wall  # wording: the bodies

    rig.home, rig.away = rig.executor.command[0], rig.home
    rig.arm.leaning = {floor: 4.0}
    rig.accept(rig.swing(collision, id="C-7.2"))
    rig.tick(100)
    rig.arm.leaning = {floor: 25.0}  # harder
    assert rig.until_end().message == floor  # wording: the bodies

    rig.home, rig.away = rig.executor.command[0], rig.away
    rig.arm.leaning = {}  # it rattles: what stopped it last is not felt just now
    rig.accept(rig.swing(collision, id="C-7.3"))
    rig.tick(50)
    rig.arm.leaning = {floor: 2.0}
    rig.tick(50)
    assert rig.executor.state is Mode.EXECUTING


SENSES = st.tuples(
    st.lists(st.floats(-40, 40), min_size=6, max_size=6),
    st.sampled_from(["", "", "", "forearm touches SATELLITE left-panel"]),
    st.floats(0, 40),
    st.booleans(),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(senses=st.lists(SENSES, min_size=1, max_size=12), halt_after=st.one_of(st.none(), st.integers(0, 60)))
def test_whatever_is_felt_every_primitive_ends_once_for_one_reason(cell, make, senses, halt_after) -> None:
    rig = make.Rig(cell)
    rig.accept(
        rig.swing(
            make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=30.0), Reflex.BACK_OFF, 0.01),
            make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=15.0, axis=[0.0, 0.0, -1.0])),
            make.stop(StopReason.TORQUE_LIMIT, p.TorqueAbove(limit_nm=30.0)),
            make.stop(StopReason.COLLISION, p.BodyTouch()),
            make.stop(StopReason.SLIP, p.GripForceBelow(2.0), Reflex.RELEASE),
            duration_s=1.0,
            limit_s=1.2,
        )
    )
    reports = []
    for n in range(4500):
        wrench, touches, grip, _ = senses[n % len(senses)]
        rig.arm.wrench, rig.arm.forces = wrench, (grip, grip)
        rig.arm.leaning = {touches: 1.0} if touches else {}
        if n == halt_after:
            rig.executor.halt()
        reports += [message for message in rig.tick() if isinstance(message, m.EndReport)]
    assert len(reports) == 1
    assert reports[0].reason in PRIORITY
    assert rig.executor.state is Mode.HOLDING
    assert rig.executor.at_rest


# --- halting ---------------------------------------------------------------------------------------------


def _bring_to(rig, make, state: Mode) -> None:
    reflexes = {
        Mode.RETREATING: Reflex.BACK_OFF,
        Mode.RELEASING: Reflex.RELEASE,
        Mode.COMPLYING: Reflex.COMPLY,
    }
    reflex = reflexes.get(state, Reflex.STOP)
    if state is Mode.RELEASING:
        rig.arm.width, rig.arm.hand = 0.02, HandCommand(0.02, 30.0, 0.05)
    if state is not Mode.HOLDING:
        rig.accept(rig.swing(_feel(make, reflex, 0.05 if reflex is Reflex.BACK_OFF else 0.0)))
        rig.tick(500)
    if state not in (Mode.HOLDING, Mode.EXECUTING):
        rig.arm.wrench = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        for _ in range(1000):
            rig.tick()
            if rig.executor.state is state:
                break
    assert rig.executor.state is state


@pytest.mark.parametrize("state", list(Mode))
def test_a_halt_in_any_state_leads_to_rest_and_to_one_report_at_most(rig, make, state: Mode) -> None:
    _bring_to(rig, make, state)
    rig.tick(5 if state in MOVING else 0)
    was = rig.executor.state
    count = len(rig.sent)

    moving = rig.executor.halt()
    rig.executor.halt()  # twice is no more than once
    brisk = rig.tick(200)
    rig.tick(2000)

    assert moving is (was in MOVING)
    assert rig.executor.state is Mode.HOLDING
    assert rig.executor.at_rest
    reports = [message for message in rig.sent[count:] if isinstance(message, m.EndReport)]
    expected = {Mode.HOLDING: [], Mode.EXECUTING: [StopReason.HALT]}.get(state, [StopReason.CONTACT])
    assert [report.reason for report in reports] == expected
    assert len(brisk) == len(expected)


def test_a_halt_brakes_with_the_next_tick(rig) -> None:
    rig.accept(rig.swing())
    rig.tick(500)
    before = _speed(rig)
    rig.executor.halt()
    rig.tick(1)
    assert _speed(rig) < before


# --- a reflex beside a limit -----------------------------------------------------------------------------


@pytest.mark.parametrize("trips", [{"force": 20.0, "reason": "force_limit"}, {"force": 50.0, "reason": "force_limit"}])
def test_a_reflex_that_was_asked_for_is_done_whichever_limit_is_named(rig, make, trips) -> None:
    """47 N in the first tick of a contact are beyond the 5 N of the sentence and the 40 N of the verb."""
    guard = make.stop(StopReason.FORCE_LIMIT, p.ForceAbove(limit_n=15.0))
    rig.accept(rig.swing(guard, _feel(make, Reflex.BACK_OFF, 0.05)))
    rig.tick(600)
    rig.arm.wrench = [trips["force"], 0.0, 0.0, 0.0, 0.0, 0.0]
    rig.tick(1)
    rig.arm.wrench = [0.0] * 6
    report = rig.until_end()
    assert report.reason == trips["reason"]
    assert report.reflex is Reflex.BACK_OFF
    assert geometry.distance(report.tcp_pose, report.trip_pose) == pytest.approx(0.05, abs=0.003)


def test_a_limit_without_the_condition_of_the_reflex_only_stops(rig, make) -> None:
    guard = make.stop(StopReason.TORQUE_LIMIT, p.TorqueAbove(limit_nm=2.0))
    rig.accept(rig.swing(guard, _feel(make, Reflex.BACK_OFF, 0.05)))
    rig.tick(600)
    rig.arm.wrench = [0.0, 0.0, 0.0, 3.0, 0.0, 0.0]
    report = rig.until_end()
    assert (report.reason, report.reflex) == (StopReason.TORQUE_LIMIT, Reflex.STOP)
