"""Frames of an arm: the chain of transforms ends at the tcp that the kinematics computes."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from rtc.apps.observers.frames import WORLD, ArmFrames, urdf_of
from rtc.spatial import geometry


@pytest.mark.parametrize("arm", ["RIGHT-ARM", "LEFT-ARM"])
def test_the_chain_of_frames_ends_at_the_tcp(cell, arms, arm):
    frames, model = ArmFrames(cell, arm), arms[arm]
    random = np.random.default_rng(7)
    for _ in range(20):
        joints = random.uniform(model.limits.lower, model.limits.upper).tolist()
        placed = {WORLD: np.array([0, 0, 0, 0, 0, 0, 1.0])}
        for parent, child, pose in frames.transforms(frames.values(joints, 0.04)):
            placed[child] = geometry.compose(placed[parent], pose)
        tcp = placed[f"{arm}/tcp"]
        assert geometry.distance(tcp, model.fk(joints)) < 1e-9
        assert geometry.angle(tcp, model.fk(joints)) < 1e-6


def test_the_fingers_stand_as_far_apart_as_the_hand_is_open(cell):
    frames = ArmFrames(cell, "LEFT-ARM")

    def gap(width_m: float) -> float:
        poses = {child: pose for _, child, pose in frames.transforms(frames.values([0.0] * 6, width_m))}
        a, b = (poses[f"LEFT-ARM/{name}"] for name in cell.arm("LEFT-ARM").gripper.finger_links)
        return geometry.distance(a, b)

    assert gap(0.06) - gap(0.02) == pytest.approx(0.04)


def test_the_attached_urdf_has_the_names_of_the_frames(cell):
    frames = ArmFrames(cell, "RIGHT-ARM")
    robot = ET.fromstring(urdf_of(cell, "RIGHT-ARM"))
    children = {child for _, child, _ in frames.transforms({})}
    assert {link.get("name") for link in robot.iter("link")} == children
    named = set(frames.values([0.0] * 6, 0.04))
    assert named <= {joint.get("name") for joint in robot.iter("joint")}
    assert {part.get("link") for tag in ("parent", "child") for part in robot.iter(tag)} <= children
