"""What a hand learns by touching: where the thing is, how well, and where to look next."""

from __future__ import annotations

import math

import msgspec
import pytest

from rtc.protocol.messages import EndReport, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.world.spread import even
from tests.workers.conftest import Bench, Kinematic

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
TURNED = math.radians(4.0)


@pytest.fixture
def feel(bench):
    """Judge one step of the script that feels, by its label, ended as `changes` say."""
    bench.unsurveyed()
    bench.without_cameras()
    script = bench.elaborate(GRASP)
    assert script.context.script == "grasp-feeling"
    bench.set_fact("RIGHT-ARM.joints", script.bindings["JCM"].joints)

    def judge(label, **changes):
        step = next(s for s in script.steps if s.label.startswith(label))
        bound = bench.bind(script, step)
        evaluation = bound.evaluation
        path = getattr(bound.primitive.trajectory, "positions", [evaluation.start_joints])  # of a hand: none
        report = EndReport(
            primitive="C-1.1",
            performer="RIGHT-ARM",
            reason=StopReason.GOAL,
            at_s=0.0,
            duration_s=1.0,
            joints=path[-1],
            tcp_pose=evaluation.goal_pose,
            wrench=[0.0] * 6,
            hand_width_m=0.08,
            hand_force_n=0.0,
        )
        report = msgspec.structs.replace(report, **changes)
        made = bench.analyze(bound, report)
        bench.world = bench.world.overlay(made.changes, source="C-1/1")
        return made

    return judge


def believed(bench):
    return bench.world.get("MACS-NEW.frame")


def at_the_handle(bench, offset, rpy=(0.0, 0.0, 0.0)):
    """A pose of the tcp, so far from the grasp point as it is believed, in axes of the tool there."""
    point = bench.model.cell.object("MACS-NEW").grasp_point("HANDLE-A").frame.pose
    there = geometry.compose(bench.model.cell.object_pose("MACS-NEW"), point)
    return geometry.compose(there, geometry.from_rpy(offset, rpy)).tolist()


@pytest.mark.parametrize("off_m", [0.020, -0.030])
def test_a_touch_that_comes_late_or_early_moves_the_thing_along_the_search_alone(bench, feel, off_m):
    was = bench.world.value("MACS-NEW.frame")
    touch = at_the_handle(bench, [0.0, 0.0, 0.035 + off_m])

    made = feel("feel the distance", reason=StopReason.CONTACT, trip_pose=touch, tcp_pose=touch)

    assert made.verdict == "continue"
    assert geometry.relative(was, believed(bench).value)[:3] == pytest.approx([off_m, 0.0, 0.0], abs=1e-3)
    x, y, z, *_ = believed(bench).spread
    assert x < 0.015  # what is not known of the yaw counts, over half a hand
    assert y == pytest.approx(0.035, abs=1e-4)
    assert z == pytest.approx(0.035, abs=1e-4)


def attitude_is_known(bench, roll):
    """As after a touch at two heights."""
    fact = believed(bench)
    spread = [*fact.spread[:3], roll, *fact.spread[4:]]
    bench.world = bench.world.overlay([WorldChange(key=fact.key, value=fact.value, spread=spread)])


@pytest.mark.parametrize("side", [1, -1])
def test_a_bar_askew_holds_the_pads_apart_and_twists_the_hand_to_its_side(bench, feel, side):
    width = 0.02 * (1.0 + TURNED)
    here = at_the_handle(bench, [0.0, 0.0, 0.0])
    attitude_is_known(bench, roll=0.001)
    twisted = [0.0, 0.0, 0.0, side * 10.0 * 0.02, 0.0, 0.0]

    feel("press", tcp_pose=here, hand_width_m=width, hand_force_n=10.0, wrench=twisted)

    turned = geometry.relative(bench.model.cell.object_pose("MACS-NEW"), believed(bench).value)
    assert geometry.to_rpy(turned)[2] == pytest.approx(-side * TURNED, abs=1e-3)  # x of the tool is down
    assert believed(bench).spread[5] < math.radians(1.0)


def test_pads_that_are_held_apart_do_not_tell_about_which_axis(bench, feel):
    """The bar may be tilted about itself, or about the approach: their sum is measured."""
    here = at_the_handle(bench, [0.0, 0.0, 0.0])
    feel("press", tcp_pose=here, hand_width_m=0.02 * (1.0 + TURNED), hand_force_n=10.0, wrench=[0, 0, 0, 0.2, 0, 0])

    roll, pitch, yaw = believed(bench).spread[3:]
    turned = geometry.to_rpy(geometry.relative(bench.model.cell.object_pose("MACS-NEW"), believed(bench).value))[2]
    for true_yaw in (0.0, -TURNED):  # all of it may be about the approach
        assert abs(true_yaw - turned) <= yaw
    assert roll > 0.9 * TURNED
    assert pitch == pytest.approx(math.radians(5.0), rel=0.1)  # nothing measures it


@pytest.mark.parametrize("twist_nm", [0.0, 0.06])
def test_without_a_clear_twist_the_width_only_bounds_how_askew_it_may_be(bench, feel, twist_nm):
    """An arm that gave way has shown 0.06 N.m of the wrong sign at 10 N, with friction 1.5."""
    here = at_the_handle(bench, [0.0, 0.0, 0.0])
    wrench = [0.0, 0.0, 0.0, twist_nm, 0.0, 0.0]

    feel("press", tcp_pose=here, hand_width_m=0.02 * (1.0 + 0.5 * TURNED), hand_force_n=10.0, wrench=wrench)

    turned = geometry.relative(bench.model.cell.object_pose("MACS-NEW"), believed(bench).value)
    assert geometry.angle(geometry.IDENTITY, turned) < 1e-6
    assert math.radians(2.0) < believed(bench).spread[5] < math.radians(3.0)


def test_fingers_that_do_not_come_to_rest_on_the_bar_are_taken_back(feel):
    """Something moved the module meanwhile: one finger presses, the other does not."""
    made = feel("press", reason=StopReason.TIMEOUT, limit=5.4, hand_width_m=0.031, hand_force_n=0.3)
    assert made.trim == 4
    assert any(change.key == "MACS-NEW.frame" and change.validity is Validity.SUSPECT for change in made.changes)
    assert not any(change.key == "RIGHT-ARM.holding" for change in made.changes)


def test_fingers_halted_while_they_press_for_a_moment_do_hold(bench, feel):
    """Otherwise the next motion would drag the module along."""
    here = at_the_handle(bench, [0.0, 0.0, 0.0])
    feel("press", reason=StopReason.HALT, tcp_pose=here, hand_width_m=0.02, hand_force_n=10.0)
    assert bench.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert bench.world.get("MACS-NEW.grasp").validity is Validity.SUSPECT


@pytest.mark.parametrize("side", [1, -1])
def test_a_finger_that_lands_on_the_handle_tells_on_which_side_it_is(bench, feel, side):
    pose = at_the_handle(bench, [0.0, 0.0, -0.020])
    push = [0.0, 0.0, -6.0, -side * 6.0 * 0.046, 0.0, 0.0]

    made = feel("straddle", reason=StopReason.CONTACT, trip_pose=pose, tcp_pose=pose, trip_wrench=push)

    assert made.trim == 2
    moved = geometry.relative(bench.model.cell.object_pose("MACS-NEW"), believed(bench).value)
    assert moved[:3] == pytest.approx([0.0, side * 0.045, 0.0], abs=1e-6)
    assert believed(bench).spread[1] >= 0.045  # nothing was measured


def test_a_pose_stated_within_a_few_millimetres_is_taken_as_in_figure_4(bench):
    bench.unsurveyed()
    assert bench.do("SET MACS-NEW FRAME 80 -80 60 CM").succeeded
    assert bench.world.get("MACS-NEW.frame").spread == pytest.approx(even(0.005, 0.035))
    assert bench.elaborate(GRASP).context.script == "grasp-centering"


@pytest.mark.physics
def test_a_seat_is_where_what_sits_in_it_was_felt_to_be():
    """It goes back there, though the cell file has the seat elsewhere."""
    bench = Bench(Kinematic())
    bench.unsurveyed()
    offset = [0.020, -0.012, 0.025]
    bench.subsystem.displace("MACS-NEW", offset)

    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM", "PLACE MACS-NEW ON RACK-1"):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)

    seat = bench.world.get("RACK-1.frame")
    off = geometry.relative(seat.value, bench.subsystem.poses["RACK-1"])
    assert all(abs(error) <= bound for error, bound in zip(off[:3], seat.spread, strict=False))
    assert geometry.distance(bench.subsystem.poses["MACS-NEW"], [0.820, -0.812, 0.625]) < 0.002
