"""The frames of an arm from its URDF: one transform per joint, from parent link to child link. Pure.

Names are `ARM/link` and `ARM/joint`, so that the frames of two arms with one URDF differ. `urdf_of` gives the URDF
with the same names.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

WORLD = "world"  # root of all frames


@dataclass(frozen=True)
class JointFrame:
    """A joint of a URDF. `origin`: pose of the child link in the parent link at joint value 0."""

    name: str
    parent: str
    child: str
    kind: str  # of the URDF: revolute, prismatic, fixed ...
    origin: Array
    axis: tuple[float, float, float]

    def pose(self, value: float) -> Array:
        """Pose of the child link in the parent link at a joint value (rad or m)."""
        x, y, z = self.axis
        if self.kind in ("revolute", "continuous"):
            sine = math.sin(0.5 * value)
            return geometry.compose(self.origin, (0.0, 0.0, 0.0, x * sine, y * sine, z * sine, math.cos(0.5 * value)))
        if self.kind == "prismatic":
            return geometry.compose(self.origin, (x * value, y * value, z * value, 0.0, 0.0, 0.0, 1.0))
        return self.origin


class ArmFrames:
    """All frames of one arm of a cell."""

    def __init__(self, cell: Cell, arm: str) -> None:
        self._arm = cell.arm(arm)
        robot = ET.fromstring(cell.urdf(arm))
        self.joints = [_joint_frame(element, arm) for element in robot.iter("joint")]
        children = {joint.child for joint in self.joints}
        roots = [name for link in robot.iter("link") if (name := f"{arm}/{link.get('name')}") not in children]
        self._base = [(WORLD, root, self._arm.base.pose) for root in roots]

    def values(self, joints: list[float], hand_width_m: float) -> dict[str, float]:
        """Joint values by the joint's frame name: those measured (rad), and each finger at half the opening (m)."""
        arm, fingers = self._arm.name, self._arm.gripper.finger_joints
        found = {f"{arm}/{name}": value for name, value in zip(self._arm.joints, joints, strict=True)}
        return found | {f"{arm}/{name}": 0.5 * hand_width_m for name in fingers}

    def transforms(self, values: Mapping[str, float]) -> Iterator[tuple[str, str, Array]]:
        """(parent frame, child frame, pose of the child in the parent) of the base and of every joint."""
        yield from self._base
        for joint in self.joints:
            yield joint.parent, joint.child, joint.pose(values.get(joint.name, 0.0))


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


def _joint_frame(element: ET.Element, arm: str) -> JointFrame:
    origin, axis = element.find("origin"), element.find("axis")
    xyz, rpy = (_numbers(None if origin is None else origin.get(name), "0 0 0") for name in ("xyz", "rpy"))
    along = _numbers(None if axis is None else axis.get("xyz"), "1 0 0")
    length = math.hypot(*along)
    return JointFrame(
        name=f"{arm}/{element.get('name')}",
        parent=f"{arm}/{_link(element, 'parent')}",
        child=f"{arm}/{_link(element, 'child')}",
        kind=element.get("type", "fixed"),
        origin=geometry.from_rpy(xyz, rpy),
        axis=(along[0] / length, along[1] / length, along[2] / length),
    )


def _link(element: ET.Element, tag: str) -> str:
    found = element.find(tag)
    assert found is not None, f"joint {element.get('name')} has no {tag}"
    return found.get("link", "")


def _numbers(text: str | None, default: str) -> list[float]:
    return [float(word) for word in (text or default).split()]
