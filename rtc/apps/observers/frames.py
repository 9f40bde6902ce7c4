"""The frames of an arm from its URDF: one transform per joint, from parent link to child link. Pure.

Names are `ARM/link` and `ARM/joint`, so that the frames of two arms with one URDF differ. `urdf_of` gives the URDF
with the same names.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping

from rtc.model.cells.cell import Cell
from rtc.model.cells.urdf import Urdf
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

WORLD = "world"  # root of all frames


class ArmFrames:
    """All frames of one arm of a cell."""

    def __init__(self, cell: Cell, arm: str) -> None:
        self._arm = cell.arm(arm)
        self._robot = Urdf(ET.fromstring(cell.urdf(arm)))
        self._origins = {name: geometry.from_matrix(self._robot.placement(name)) for name in self._robot.joints}
        self._axes = {name: self._robot.axis(name).tolist() for name in self._robot.joints}

    def values(self, joints: list[float], hand_width_m: float) -> dict[str, float]:
        """Joint values by the joint's frame name: those measured (rad), and each finger at half the opening (m)."""
        arm, fingers = self._arm.name, self._arm.gripper.finger_joints
        found = {f"{arm}/{name}": value for name, value in zip(self._arm.joints, joints, strict=True)}
        return found | {f"{arm}/{name}": 0.5 * hand_width_m for name in fingers}

    def transforms(self, values: Mapping[str, float]) -> Iterator[tuple[str, str, Array]]:
        """(parent frame, child frame, pose of the child in the parent) of the base and of every joint."""
        arm, robot = self._arm.name, self._robot
        yield from ((WORLD, f"{arm}/{link}", self._arm.base.pose) for link in robot.links if link not in robot.carrier)
        for joint in robot.joints:
            pose = self._pose(joint, values.get(f"{arm}/{joint}", 0.0))
            yield f"{arm}/{robot.parent[joint]}", f"{arm}/{robot.child[joint]}", pose

    def _pose(self, joint: str, value: float) -> Array:
        """Pose of the child link in the parent link at a joint value (rad or m)."""
        x, y, z = self._axes[joint]
        match self._robot.type(joint):
            case "revolute" | "continuous":
                sine = math.sin(0.5 * value)
                turn = (0.0, 0.0, 0.0, x * sine, y * sine, z * sine, math.cos(0.5 * value))
                return geometry.compose(self._origins[joint], turn)
            case "prismatic":
                return geometry.compose(self._origins[joint], (x * value, y * value, z * value, 0.0, 0.0, 0.0, 1.0))
            case _:
                return self._origins[joint]


def urdf_of(cell: Cell, arm: str) -> bytes:
    """The URDF of an arm with the names of its frames."""
    robot = ET.fromstring(cell.urdf(arm))
    robot.set("name", arm)
    for element in robot.iter():
        if element.tag in ("link", "joint") and "name" in element.attrib:
            element.set("name", f"{arm}/{element.get('name')}")
        elif element.tag in ("parent", "child"):
            element.set("link", f"{arm}/{element.get('link')}")
        elif element.tag == "mimic":
            element.set("joint", f"{arm}/{element.get('joint')}")
    return ET.tostring(robot, encoding="utf-8", xml_declaration=True)
