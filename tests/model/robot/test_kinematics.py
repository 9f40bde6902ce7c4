"""Forward and inverse kinematics against published figures, each other, and plain differences."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from rtc.model.robot import numeric_ik
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import causes
from rtc.spatial import geometry


def random_joints(arm, n, seed):
    return np.random.default_rng(seed).uniform(arm.limits.lower, arm.limits.upper, (n, 6))


def test_zero_pose_is_the_published_one(cell):
    # The published tool point (0.4521, -0.15, 0.4318) is the wrist's centre, seen from the shoulder at 0.672 m.
    arm = ArmModel(cell.urdf("RIGHT-ARM"), tcp_link="flange")
    assert np.allclose(arm.fk([0] * 6)[:3], (0.4521, -0.15005, 0.4318 + 0.672), atol=1e-6)


def test_fk_is_the_published_chain(cell):
    """Against the standard Denavit-Hartenberg product, written out here."""
    arm = ArmModel(cell.urdf("RIGHT-ARM"), tcp_link="flange")
    rows = [
        (0.672, 0, math.pi / 2),
        (0, 0.4318, 0),
        (0.15005, 0.0203, -math.pi / 2),
        (0.4318, 0, math.pi / 2),
        (0, 0, -math.pi / 2),
        (0, 0, 0),
    ]
    for joints in random_joints(arm, 50, 1):
        product = np.eye(4)
        for q, (d, a, alpha) in zip(joints, rows, strict=True):
            c, s, ca, sa = math.cos(q), math.sin(q), math.cos(alpha), math.sin(alpha)
            product = product @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        assert np.allclose(geometry.to_matrix(arm.fk(joints)), product, atol=1e-9)


def test_the_base_moves_the_tcp(cell, right):
    at_origin = ArmModel(cell.urdf("RIGHT-ARM"))
    for joints in random_joints(right, 5, 2):
        expected = geometry.compose(right.base_pose, at_origin.fk(joints))
        assert np.allclose(geometry.normalise(expected), right.fk(joints), atol=1e-12)


def test_the_jacobian_is_the_slope_of_fk(cell):
    turned = ArmModel(cell.urdf("RIGHT-ARM"), geometry.from_rpy((0.3, -0.2, 0.1), (0.4, 0.2, 1.0)))
    h = 1e-6
    for joints in random_joints(turned, 5, 3):
        jacobian = turned.jacobian(joints)
        for n in range(6):
            ahead, behind = joints + h * np.eye(6)[n], joints - h * np.eye(6)[n]
            a, b = turned.fk(behind), turned.fk(ahead)
            slope = np.concatenate((b[:3] - a[:3], geometry.rotation_vector(a, b))) / (2 * h)
            assert np.allclose(jacobian[:, n], slope, atol=1e-6)


def test_ik_finds_its_way_back_from_200_postures(right):
    for joints in random_joints(right, 200, 4):
        target = right.fk(joints)
        solutions = right.ik(target, near=joints)
        assert np.abs(solutions[0] - joints).max() < 1e-6  # the posture it came from is the nearest
        for solution in solutions:
            assert geometry.distance(right.fk(solution), target) < 1e-9
            assert geometry.angle(right.fk(solution), target) < 1e-9
            assert right.limit_margin_rad(solution) >= 0


def test_solutions_differ_and_are_sorted(right):
    target = geometry.make_pose((0.65, -0.885, 0.6), geometry.LEVEL)
    near = np.radians([-30, 40, -170, -40, 50, 20])
    solutions = right.ik(target, near)
    travels = right.travel_times_s(solutions, near).tolist()
    assert len(solutions) == 6
    assert travels == sorted(travels)
    assert all(np.abs(a - b).max() > 0.1 for i, a in enumerate(solutions) for b in solutions[:i])


def test_the_nearest_branch_is_that_of_all_branches(right):
    """`nearest_ik` completes only branches that can be the nearest; with steps as long as those of a detour."""
    rng = np.random.default_rng(8)
    for joints in random_joints(right, 200, 6):
        near = joints + rng.uniform(-1.5, 1.5, 6)
        target = right.fk(joints)
        table = np.array(right._branches(target, near))
        table -= 2 * math.pi * np.round((table - near) / (2 * math.pi))
        nearest_s = right.travel_times_s(table, near).min()
        found = right.nearest_ik(target, near)
        assert any(np.allclose(found, q, atol=1e-9) for q in table)
        assert right.travel_times_s([found], near)[0] == pytest.approx(nearest_s, abs=1e-9)


def test_a_line_is_followed_as_each_of_its_poses(right):
    begin, end = right.fk([0.2, 0.9, -2.4, 0.7, 0.4, 0.4]), right.fk([0.3, 0.8, -2.3, 0.6, 0.5, 0.3])
    fractions = np.linspace(0.1, 1.0, 7)
    poses = geometry.interpolate_all(begin, end, fractions)
    now, rows = [0.2, 0.9, -2.4, 0.7, 0.4, 0.4], []
    for pose in poses:
        now = right.nearest_ik(pose, now)
        rows.append(now)
    assert np.allclose(right.ik_along(poses, [0.2, 0.9, -2.4, 0.7, 0.4, 0.4]), rows, atol=1e-9)
    far = geometry.make_pose((3.0, 0.0, 0.6), geometry.LEVEL)
    assert len(right.ik_along([poses[0], far, poses[1]], [0.2, 0.9, -2.4, 0.7, 0.4, 0.4])) == 1


def test_a_straight_wrist_keeps_the_roll_of_the_reference(right):
    joints = np.array([0.2, 0.9, -2.4, 0.7, 0.0, 0.4])
    assert np.allclose(right.ik(right.fk(joints), joints)[0], joints, atol=1e-6)


def test_the_numeric_inverse_agrees_with_the_closed_form(cell, right):
    """Every posture the search finds is one the closed form knows, and it finds the one it starts beside."""
    for joints in random_joints(right, 5, 5):
        target = right.fk(joints)
        known = right.ik(target)
        flange = geometry.to_matrix(geometry.relative(right.base_pose, target))
        found = numeric_ik.Chain(right.model, right.tcp_frame).solutions(pin.SE3(flange), joints + 0.05)
        assert any(np.abs(q - joints).max() < 1e-6 for q in found)
        for q in found:
            assert any(np.abs(np.remainder(q - k + np.pi, 2 * np.pi) - np.pi).max() < 1e-6 for k in known)


def test_another_kind_of_arm_is_solved_by_search(cell):
    """A forearm that is bent makes it no PUMA: the closed form must not be used for it."""
    urdf = cell.urdf("RIGHT-ARM").replace('xyz="0.0203 0 0.15005"', 'xyz="0.0203 0.05 0.15005"')
    assert urdf != cell.urdf("RIGHT-ARM")
    other = ArmModel(urdf)
    joints = np.array([0.3, 0.8, -2.2, 0.5, 0.9, -0.4])
    solutions = other.ik(other.fk(joints), near=joints + 0.1)
    assert solutions
    assert np.abs(solutions[0] - joints).max() < 1e-6
    assert all(geometry.distance(other.fk(q), other.fk(joints)) < 1e-7 for q in solutions)


def test_out_of_reach_tells_by_how_much(right):
    far = geometry.make_pose((1.2, -0.45, 0.672), geometry.LEVEL)  # 1.2 m straight before the shoulder
    assert right.ik(far) == []
    refusal = right.why_no_ik(far)
    assert isinstance(refusal.cause, causes.OutOfReach)
    # The wrist is 0.191 m behind the tcp; the shoulder's offset counts sideways only.
    missing = math.sqrt((1.2 - 0.191) ** 2 - 0.15005**2) - 0.4318 - math.hypot(0.4318, 0.0203)
    assert refusal.cause.distance_m == pytest.approx(missing, abs=1e-9)


def test_too_near_names_the_joint_and_its_limit(right):
    near = geometry.make_pose((0.35, -0.70, 0.60), geometry.LEVEL)
    refusal = right.why_no_ik(near)
    assert isinstance(refusal.cause, causes.JointLimitPassed)
    assert refusal.cause.joint == "joint_3"
    assert refusal.cause.limit_rad == pytest.approx(math.radians(-225))
    assert refusal.cause.excess_rad == pytest.approx(refusal.cause.limit_rad - refusal.cause.value_rad, abs=1e-12)


def test_a_margin_takes_solutions_away(right):
    target = geometry.make_pose((0.48, -0.085, 0.7), geometry.LEVEL)
    assert len(right.ik(target)) > len(right.ik(target, margin_rad=math.radians(15))) > 0
    refusal = right.why_no_ik(target, margin_rad=math.radians(40))
    assert refusal.cause.excess_rad == pytest.approx(
        math.radians(40) - max(right.limit_margin_rad(q) for q in right.ik(target)), abs=1e-6
    )


def test_what_can_be_reached_has_no_reason_why_not(right, home):
    assert right.why_no_ik(right.fk(home["RIGHT-ARM"])) is None
    assert right.why_not_within(home["RIGHT-ARM"]) is None


def test_singularities_show(right):
    assert right.sigma_min([0.2, 0.9, -2.4, 0.7, 0.0, 0.4]) < 1e-9  # wrist straight
    assert right.sigma_min([0.2, 0.9, -2.4, 0.7, 0.8, 0.4]) > 0.1


def test_a_posture_is_turned_to_an_attitude_and_moved_with_it(right):
    random = np.random.default_rng(4)
    for q in random.uniform(0.5 * right.limits.lower, 0.5 * right.limits.upper, (20, 6)):
        turned = right.turned_to(right.fk(random.uniform(right.limits.lower, right.limits.upper)), q)
        assert turned is None or np.isfinite(turned).all()
    near = np.array([0.2, 0.9, -2.4, 0.3, 0.6, 0.4])
    level = geometry.compose(right.fk(near), geometry.from_rpy((0, 0, 0), (0.3, -0.2, 0.4)))
    turned = right.turned_to(level, near)
    assert geometry.angle(right.fk(turned), level) < 2e-3
    moved = right.moved_by((0.02, -0.03, 0.10), turned)
    assert geometry.distance(right.fk(moved), geometry.translate(right.fk(turned), (0.02, -0.03, 0.10))) < 0.003
    assert geometry.angle(right.fk(moved), right.fk(turned)) < 0.01
