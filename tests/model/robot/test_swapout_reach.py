"""The default cell's lay-out: every station of the module swap-out can be reached, freely, by the arm meant for it.

What is asserted here is what PUMA geometry makes delicate: near stations fall into the elbow's dead zone.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from rtc.model.robot.collision_scene import Held, Scene
from rtc.protocol import causes
from rtc.spatial import geometry

MARGIN = math.radians(15)

# (arm, object, grasp point): who takes what by which handle in the racks
IN_RACKS = [
    ("RIGHT-ARM", "MACS-NEW", "HANDLE-A"),
    ("RIGHT-ARM", "MACS-NEW", "HANDLE-B"),
    ("LEFT-ARM", "MACS-OLD", "HANDLE-B"),
    ("LEFT-ARM", "MACS-OLD", "HANDLE-A"),
]
IN_BAY = [(arm, handle) for arm in ("RIGHT-ARM", "LEFT-ARM") for handle in ("HANDLE-A", "HANDLE-B")]


def grasp_pose(cell, thing, point, at=None):
    pose = cell.object_pose(thing) if at is None else at
    return geometry.compose(pose, cell.object(thing).grasp_point(point).frame.pose)


def along(arm, start, poses, world, home, scene=None):
    """Follow straight lines from the free branch nearest to home; the joints at each centimetre, all free."""
    joints = []
    for a, b in itertools.pairwise([start, *poses]):
        steps = max(2, math.ceil(geometry.distance(a, b) / 0.01))
        for pose in geometry.interpolate_all(a, b, np.linspace(0, 1, steps)):
            near = joints[-1] if joints else home[arm.name]
            q = arm.nearest_ik(pose, near)
            assert q is not None
            assert not joints or np.abs(q - joints[-1]).max() < 0.3
            joints.append(q)
    hit = world.check_path(arm.name, joints, home, scene or Scene())
    assert hit is None, f"{hit}"
    return joints


def least_margin(arm, joints):
    return min(arm.limit_margin_rad(q) for q in joints)


@pytest.mark.parametrize(("name", "thing", "point"), IN_RACKS)
def test_rack_handles_are_approached_from_100_mm(cell, world, arms, home, name, thing, point):
    pose = grasp_pose(cell, thing, point)
    before = geometry.compose(pose, (0, 0, -cell.numbers.approach_m, 0, 0, 0, 1))
    joints = along(arms[name], before, [pose], world, home)
    assert least_margin(arms[name], joints) > MARGIN
    assert min(arms[name].sigma_min(q) for q in joints) > 0.15


@pytest.mark.parametrize(
    ("name", "thing", "point"),
    [("RIGHT-ARM", "MACS-NEW", "HANDLE-A"), ("LEFT-ARM", "MACS-OLD", "HANDLE-B")],
)
def test_modules_are_lifted_150_mm_and_drawn_back_250_mm(cell, world, arms, home, name, thing, point):
    pose = grasp_pose(cell, thing, point)
    scene = Scene(
        held={thing: Held(name, geometry.relative(pose, cell.object_pose(thing)))},
        openings_m={name: 0.02},
    )
    up = geometry.translate(pose, (0, 0, 0.15))
    joints = along(arms[name], pose, [up, geometry.translate(up, (-0.25, 0, 0))], world, home, scene)
    assert least_margin(arms[name], joints) > math.radians(10)


@pytest.mark.parametrize(("name", "point"), IN_BAY)
def test_the_bay_is_reached_by_either_arm_at_either_handle(cell, world, arms, home, name, point):
    """A module in the bay drawn out 300 mm, alone with its arm before the satellite (the other one stowed)."""
    stowed = {**home, **{arm.name: arm.stow_rad for arm in cell.arms if arm.name != name}}
    seated = cell.seated_pose("BAY-2")
    pose = grasp_pose(cell, "MACS-NEW", point, seated)
    scene = Scene(held={"MACS-NEW": Held(name, geometry.relative(pose, seated))}, openings_m={name: 0.02})
    out = geometry.translate(pose, (-0.30, 0, 0))
    joints = along(arms[name], pose, [out], world, stowed, scene)
    assert least_margin(arms[name], joints) > math.radians(4)


def test_places_are_free_and_away_from_limits(cell, world, arms, home):
    for place in cell.places:
        for name, frame in place.poses.items():
            q = arms[name].ik(frame.pose, home[name])[0]
            assert arms[name].limit_margin_rad(q) > MARGIN, f"{place.name} {name}"
            assert world.check({**home, name: q}) is None, f"{place.name} {name}"


def test_home_and_stow_are_away_from_limits_and_home_is_level(cell, arms):
    level = cell.attitudes["LEVEL"].pose
    for spec in cell.arms:
        arm = arms[spec.name]
        assert arm.limit_margin_rad(spec.home_rad) > MARGIN
        assert arm.limit_margin_rad(spec.stow_rad) > MARGIN
        assert geometry.angle(arm.fk(spec.home_rad), level) < math.radians(0.01)


def test_the_far_rack_is_out_of_reach(cell, arms):
    for name, thing in (("LEFT-ARM", "MACS-NEW"), ("RIGHT-ARM", "MACS-OLD")):
        for point in ("HANDLE-A", "HANDLE-B"):
            refusal = arms[name].why_no_ik(grasp_pose(cell, thing, point))
            assert isinstance(refusal.cause, causes.OutOfReach)
            assert refusal.cause.distance_m > 0.2
