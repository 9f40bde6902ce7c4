"""Lines: straight where they say so, dense enough, and refused with the place where they end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.protocol import causes
from rtc.protocol.outcomes import RefusalReason
from rtc.spatial import geometry
from tests.workers.refusals import refusal_of
from workers.planning.motion.path import joint_line, spline_through, task_line, through


def level(x, y, z):
    return geometry.make_pose((x, y, z), geometry.LEVEL)


def at(arm, home, *xyz):
    return arm.ik(level(*xyz), home[arm.name])[0]


LINES = [
    ((0.45, -0.885, 0.60), (0.65, -0.885, 0.60), 0.0),
    ((0.65, -0.885, 0.60), (0.65, -0.885, 0.75), 0.0),
    ((0.48, -0.085, 0.70), (0.78, -0.085, 0.70), 0.0),
    ((0.60, -0.30, 0.95), (0.65, -0.80, 0.80), 0.5),
]


@pytest.mark.parametrize(("start", "goal", "yaw"), LINES)
def test_a_task_line_is_straight_and_turns_evenly(right, home, start, goal, yaw):
    begin = at(right, home, *start)
    end_pose = geometry.compose(geometry.from_rpy(goal, (0, 0, yaw)), (0, 0, 0, *geometry.LEVEL))
    line = task_line(right, begin, end_pose)
    s = np.linspace(0, line.length, 211)  # between the knots too
    for fraction, joints in zip(s / line.length, line.at(s)[0], strict=True):
        ideal = geometry.interpolate_all(right.fk(begin), end_pose, np.array([fraction]))[0]
        pose = right.fk(joints)
        assert geometry.distance(pose, ideal) < 1e-4  # 0.1 mm, the most that is allowed; it is a few micrometres
        assert geometry.angle(pose, ideal) < 1e-4


def test_a_turn_that_ends_at_a_limit_states_its_degrees(right, home):
    """It stated 0 mm of 0 mm, then a share alone."""
    begin = at(right, home, 0.45, -0.885, 0.6)
    upright = right.fk(begin)
    turned = geometry.compose(upright, geometry.from_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, 0.0]))
    refusal = refusal_of(lambda: task_line(right, begin, turned, math.radians(3.0)))
    assert 0.0 < refusal.fraction < 1.0
    assert f"after {180.0 * refusal.fraction:.0f} deg of 180 deg" in refusal.where  # wording: figures


def test_s_of_a_task_line_counts_metres(right, home):
    line = task_line(right, at(right, home, 0.45, -0.885, 0.6), level(0.65, -0.885, 0.6))
    assert line.length == pytest.approx(0.2)


def test_a_pure_turn_is_a_line_too(right, home):
    begin = at(right, home, 0.60, -0.60, 0.8)
    turned = geometry.compose(right.fk(begin), geometry.from_rpy((0, 0, 0), (0, 0, 0.4)))
    line = task_line(right, begin, turned)
    assert line.length == pytest.approx(0.25 * 0.4)
    assert geometry.distance(right.fk(line.knots[-1]), right.fk(begin)) < 1e-9
    assert geometry.angle(right.fk(line.knots[-1]), turned) < 1e-9


def test_derivatives_are_those_of_the_joints(right, home):
    line = task_line(right, at(right, home, 0.45, -0.885, 0.6), level(0.65, -0.885, 0.6))
    s, h = np.linspace(0.02, 0.18, 9), 1e-5
    (behind, _, _), (q, slope, bend), (ahead, _, _) = line.at(s - h), line.at(s), line.at(s + h)
    assert np.allclose(slope, (ahead - behind) / (2 * h), atol=1e-5)
    assert np.allclose(bend, (ahead - 2 * q + behind) / h**2, atol=1e-3)


def test_dense_leaves_no_gap(right, home):
    path = joint_line(home["RIGHT-ARM"], at(right, home, 0.45, -0.885, 0.6))
    s, joints = path.dense(weights=right.step_weights)
    hands = np.array([right.fk(q)[:3] for q in joints])
    assert np.linalg.norm(np.diff(hands, axis=0), axis=1).max() < 0.03
    assert np.allclose(joints[[0, -1]], path.knots)
    assert (np.diff(s) > 0).all()


@pytest.mark.parametrize("radius", [0.0, 0.05, None])
def test_a_rounded_corner_stays_within_its_triangle(right, home, radius):
    a, b = np.array(home["RIGHT-ARM"]), at(right, home, 0.45, -0.885, 0.6)
    corner = (a + b) / 2 + 0.2
    path = through([a, corner, b], None if radius is None else np.array([radius]))
    assert np.allclose(path.at(path.s[[0, 2]])[0], [a, b])
    off = np.abs(path.at(path.s[1:2])[0] - corner).max()
    assert off < 1e-8 if radius == 0.0 else 0 < off <= 0.3125 * (radius or path.s[-1])
    assert len(through([a, b]).knots) == 2


def test_a_rounded_corner_bends_without_a_leap(right, home):
    a, b = np.array(home["RIGHT-ARM"]), at(right, home, 0.45, -0.885, 0.6)
    path = through([a, (a + b) / 2 + 0.2, b - 0.3, b])
    s = np.linspace(0.0, path.length, 40001)
    (q, slope, bend), h = path.at(s), s[1]
    assert np.allclose(slope[1:-1], (q[2:] - q[:-2]) / (2 * h), atol=1e-4)
    assert np.allclose(bend[1:-1], (slope[2:] - slope[:-2]) / (2 * h), atol=1e-2)


def test_out_of_reach_on_the_way_tells_where(right, home):
    refusal = refusal_of(task_line, right, at(right, home, 0.65, -0.885, 0.6), level(1.25, -0.885, 0.6))
    assert isinstance(refusal.cause, causes.OutOfReach)
    assert 0.1 < refusal.fraction < 0.6
    assert refusal.along_m == pytest.approx(0.6 * refusal.fraction)


def test_a_joint_limit_on_the_way_names_the_joint(right, home):
    """Drawn back towards its own shoulder the hand comes to the elbow's limit."""
    refusal = refusal_of(task_line, right, at(right, home, 0.65, -0.70, 0.6), level(0.25, -0.70, 0.6))
    assert isinstance(refusal.cause, causes.JointLimitPassed)
    assert refusal.cause.joint == "joint_3"
    assert 0 < refusal.fraction < 1


@pytest.mark.parametrize("far_m", [1e6, 1e20, 1e308])
def test_a_line_that_no_arm_goes_is_refused_without_its_samples(right, home, far_m):
    """Its knots at 25 mm would take the memory of the machine."""
    goal = geometry.translate(right.fk(home["RIGHT-ARM"]), [0.0, 0.0, far_m])
    assert refusal_of(task_line, right, home["RIGHT-ARM"], goal).reason is RefusalReason.INFEASIBLE


def test_a_singularity_on_the_way_is_reported_as_such(right):
    """Nodding past a straight wrist, and a little aside of it: joints 4 and 6 would have to turn about at once."""
    before, after = [0.2, 0.9, -2.4, 0.0, 0.3, 0.0], [0.2, 0.9, -2.4, 0.0, -0.3, 0.0]
    goal = geometry.compose(right.fk(after), geometry.from_rpy((0, 0, 0), (0.02, 0, 0)))
    refusal = refusal_of(task_line, right, before, goal)
    assert isinstance(refusal.cause, causes.Singular)
    assert refusal.cause.joint in ("joint_4", "joint_6")
    assert refusal.cause.sigma_min < 0.05
    assert math.degrees(refusal.cause.leap_rad) > 30


@pytest.mark.parametrize("radius", [0.0, 0.002, 0.02, 0.2, None])
def test_a_path_is_no_farther_off_its_chords_than_stated(right, home, radius):
    rng = np.random.default_rng(7)
    corners = [np.array(home["RIGHT-ARM"]) + rng.uniform(-0.6, 0.6, 6) for _ in range(5)]
    rounded = through(corners, None if radius is None else np.full(3, radius))
    for path in (rounded, spline_through(corners), joint_line(corners[0], corners[1])):
        s, joints = path.dense(0.04, right.step_weights)
        stated, fine = path.off_chords(s), np.linspace(0.0, 1.0, 21)
        most = []
        for n in range(len(s) - 1):
            chord = joints[n] + fine[:, None] * (joints[n + 1] - joints[n])
            off = np.abs(path.joints_at(s[n] + fine * (s[n + 1] - s[n])) - chord).max(axis=0)
            assert (off <= (stated[n] if len(stated) else 0.0) + 1e-9).all()
            most.append(off.max())
        if len(stated) and radius is None:
            assert stated.max() < 5 * max(most)  # it is no idle bound
