"""Inverse kinematics without a closed form, on arms with redundant joints, slides and whole turns of range."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pybullet_data
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import causes
from rtc.spatial import geometry
from tests.apps.authoring import small_arms

DATA = Path(pybullet_data.getDataPath())
MARGIN = 0.05
SLIDE = """
  <link name="rail"><inertial><mass value="20"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="rail_x" type="prismatic"><parent link="rail"/><child link="pedestal"/><axis xyz="1 0 0"/>
    <limit lower="-0.8" upper="0.8" effort="500" velocity="0.5"/></joint>
  <link name="pedestal">"""


@pytest.fixture(scope="module")
def panda() -> ArmModel:
    urdf = (DATA / "franka_panda" / "panda.urdf").read_text()
    return ArmModel(urdf, joints=[f"panda_joint{n}" for n in range(1, 8)], tcp_link="panda_grasptarget", name="PANDA")


@pytest.fixture(scope="module")
def xarm() -> ArmModel:
    urdf = (DATA / "xarm" / "xarm6_robot.urdf").read_text()
    return ArmModel(urdf, joints=[f"joint{n}" for n in range(1, 7)], tcp_link="link6", name="XARM")


@pytest.fixture(scope="module")
def gantry(cell) -> ArmModel:
    urdf = cell.urdf("RIGHT-ARM").replace('<link name="pedestal">', SLIDE)
    return ArmModel(urdf, joints=["rail_x", *cell.arm("RIGHT-ARM").joints], name="GANTRY")


@pytest.fixture(params=["panda", "xarm", "gantry"])
def arm(request) -> ArmModel:
    return request.getfixturevalue(request.param)


def random_joints(arm: ArmModel, count: int, seed: int) -> np.ndarray:
    limits = arm.limits
    return np.random.default_rng(seed).uniform(limits.lower + MARGIN, limits.upper - MARGIN, (count, len(limits.lower)))


def test_each_reachable_pose_has_solutions_within_the_margin(arm):
    near = arm.middle
    for joints in random_joints(arm, 40, 7):
        found = arm.ik(arm.fk(joints), near, MARGIN)
        assert found
        for q in found:
            assert geometry.distance(arm.fk(q), arm.fk(joints)) < 1e-8
            assert geometry.angle(arm.fk(q), arm.fk(joints)) < 1e-7
            assert arm.limit_margin_rad(q) >= MARGIN - 1e-12
        near = found[0]


def test_the_same_call_has_the_same_result(panda):
    joints = random_joints(panda, 1, 3)[0]
    assert np.array_equal(panda.ik(panda.fk(joints)), panda.ik(panda.fk(joints)))


def test_redundant_joints_give_several_postures_of_one_hand_pose(panda):
    """So a collision of the elbow leaves other choices."""
    target = panda.fk([0.0, -0.4, 0.0, -2.0, 0.0, 1.7, 0.8])
    elbows = [q[0] for q in panda.ik(target, margin_rad=MARGIN)]
    assert max(elbows) - min(elbows) > 0.5


def test_the_first_solution_of_a_long_motion_is_far_from_limits(panda):
    def near_limit(q: np.ndarray) -> bool:
        limits = panda.limits
        return bool((np.minimum(q - limits.lower, limits.upper - q) / (limits.upper - limits.lower)).min() < 0.06)

    ranked, quickest = 0, 0
    for joints in random_joints(panda, 40, 11):
        found = panda.ik(panda.fk(joints), panda.middle, MARGIN)
        ranked += near_limit(found[0])
        quickest += near_limit(found[panda.travel_times_s(found, panda.middle).argmin()])
    assert ranked < quickest
    assert ranked <= 8


def test_a_short_motion_of_the_hand_is_a_short_motion_of_the_arm(gantry, panda):
    """Between a pose before an object and the grasp the hand must not swing."""
    for arm in (gantry, panda):
        for joints in random_joints(arm, 20, 5):
            back = geometry.compose(arm.fk(joints), (0.0, 0.0, -0.05, 0.0, 0.0, 0.0, 1.0))
            reachable = arm.nearest_ik(back, joints)
            if arm.sigma_min(joints) > 0.1 and reachable is not None and arm.limit_margin_rad(reachable) > MARGIN:
                first = arm.ik(back, joints, MARGIN)[0]
                assert arm.travel_times_s([first], joints)[0] < 0.6


def test_a_line_is_followed_without_leaps(arm):
    start = arm.middle + np.linspace(0.3, 0.5, len(arm.joints)) * np.where(arm.slides, 0.2, 1.0)
    begin = arm.fk(start)
    end = geometry.translate(begin, (-0.05, 0.10, 0.05))
    rows = arm.ik_along([*geometry.interpolate_all(begin, end, np.linspace(0.1, 1.0, 10))], start)
    assert len(rows) == 10
    assert geometry.distance(arm.fk(rows[-1]), end) < 1e-8
    assert np.abs(np.diff(np.vstack((start, rows)), axis=0)).max() < 0.25


def test_out_of_reach_states_the_distance_and_a_limit_its_joint(panda):
    far = panda.why_no_ik(geometry.make_pose((1.5, 0.0, 0.4)))
    assert far is not None
    assert isinstance(far.cause, causes.OutOfReach)
    assert 0.3 < far.cause.distance_m < 0.9
    behind = panda.fk([0.0, 0.3, 0.0, 0.4, 0.0, 2.0, 0.0])  # joint 4 bends one way only
    refused = panda.why_no_ik(behind, math.radians(3.0))
    reachable = panda.ik(behind, margin_rad=math.radians(3.0))
    assert (refused is None) == bool(reachable)


def test_a_slide_has_no_turns_and_its_limit_is_stated_in_mm(gantry):
    assert gantry.slides == [True, *[False] * 6]
    assert gantry.step_weights[0] == 1.0
    refusal = gantry.why_not_within([0.9, *[0.0] * 6])
    assert refusal is not None
    assert "900 mm" in refusal.message  # wording: the unit of a slide
    target = gantry.fk([0.6, 0.3, 0.8, -2.2, 0.5, 0.9, -0.4])
    assert all(-0.8 <= q[0] <= 0.8 for q in gantry.ik(target))


def test_whole_turns_are_used_where_the_limits_allow_them(xarm):
    joints = np.array([3.0, 0.2, -1.0, 0.5, 0.4, 5.5])
    assert np.abs(xarm.ik(xarm.fk(joints), joints)[0] - joints).max() < 1e-6


def test_the_closed_form_keeps_its_weights(right):
    assert np.allclose(right.step_weights, [1, 1, 1, 1 / 3, 1 / 3, 1 / 3])


def test_without_a_solution_there_is_a_cause_and_with_one_there_is_none(panda):
    """Whatever the reference, at the edge of the reach and near limits too."""
    random = np.random.default_rng(9)
    reached = 0
    for joints in random_joints(panda, 24, 13):
        pose = panda.fk(joints)
        edge = geometry.make_pose(pose[:3] * random.uniform(0.9, 1.3), random.normal(size=4))
        near = random.uniform(panda.limits.lower, panda.limits.upper)
        found = panda.ik(edge, near, 0.2)
        assert (panda.why_no_ik(edge, 0.2) is None) <= bool(found)
        reached += bool(found)
    assert 2 < reached < 22


# --- arms with few joints, and slides ----------------------------------------------------------------------


def few(joints: list[small_arms.Joint]) -> ArmModel:
    """The arm, its tcp in the origin of its last link."""
    names = [f"joint_{n}" for n in range(1, len(joints) + 1)]
    return ArmModel(small_arms.urdf("few", joints), joints=names, tcp_link=f"link_{len(joints)}", name="FEW")


@pytest.mark.parametrize("joints", [small_arms.SCARA, small_arms.PORTAL, small_arms.FIVE])
def test_an_arm_with_few_joints_reaches_its_poses_as_well_as_figures_are_rounded(joints):
    """Places in 0.1 mm and attitudes in 0.1 degrees, as people write them."""
    arm = few(joints)
    for q in random_joints(arm, 20, 5):
        pose = arm.fk(q)
        pose[:3] = np.round(pose[:3], 4)
        goal = geometry.from_rpy(pose[:3], np.radians(np.round(np.degrees(geometry.to_rpy(pose)), 1)))
        found = arm.ik(goal, arm.middle, 0.5 * MARGIN)
        assert found
        for solution in found:
            assert geometry.distance(arm.fk(solution), goal) < 0.0003
            assert geometry.angle(arm.fk(solution), goal) < math.radians(0.3)
        assert len(arm.ik_along([goal], q)) == 1


def test_what_an_arm_with_few_joints_cannot_reach_is_refused_with_its_reason():
    arm = few(small_arms.SCARA)
    tilted = geometry.compose(arm.fk(arm.middle), geometry.from_rpy((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)))
    assert arm.ik(tilted) == []
    why = arm.why_no_ik(tilted)
    assert why is not None
    assert isinstance(why.cause, causes.OutOfReach)
    assert math.degrees(why.cause.turned_rad) == pytest.approx(11.5, abs=0.5)


def test_the_margin_of_a_slide_is_some_millimetres():
    arm = few(small_arms.PORTAL)
    three_deg = math.radians(3.0)
    near_the_end = arm.limits.lower + 0.006
    assert arm.why_not_within(near_the_end, three_deg) is None
    assert arm.limit_margin_rad(near_the_end) > three_deg
    assert len(arm.ik(arm.fk(near_the_end), arm.middle, three_deg)) == 1
    refusal = arm.why_not_within(arm.limits.lower + 0.004, three_deg)
    assert refusal is not None
    assert refusal.message.endswith("with a margin of 5 mm")  # wording: the unit of a slide
