"""A URDF as links and joints. Poses are 4 x 4 matrices, child in parent; values are rad and m. Pure.

It reads what is there: faults are stated by `rtc.model.cells.urdf_values`. A number that cannot be read raises
ProgramError.
"""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

import numpy as np

from rtc.model.cells import urdf_values
from rtc.model.cells.urdf_values import MOVING
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry
from rtc.spatial.geometry import Array


class Urdf:
    """The tables of a <robot>; call `index` after a change of its elements."""

    def __init__(self, robot: Element) -> None:
        self.robot = robot
        self.index()

    def index(self) -> None:
        self.links = {str(link.get("name")): link for link in self.robot.findall("link")}
        self.joints = {str(joint.get("name")): joint for joint in self.robot.findall("joint")}
        self.parent = {name: _end(joint, "parent") for name, joint in self.joints.items()}
        self.child = {name: _end(joint, "child") for name, joint in self.joints.items()}
        self.carrier = {link: name for name, link in self.child.items()}

    def type(self, joint: str) -> str:
        return str(self.joints[joint].get("type"))

    def way_to(self, link: str) -> list[str]:
        """The joints from the root to a link, in order."""
        way: list[str] = []
        while link in self.carrier and len(way) <= len(self.joints):  # joints may form a ring
            way.append(self.carrier[link])
            link = self.parent[way[-1]]
        return way[::-1]

    def moving_way(self, link: str) -> list[str]:
        return [joint for joint in self.way_to(link) if self.type(joint) in MOVING]

    def limits(self, joint: str) -> tuple[float, float]:
        """(lower, upper); of a continuous joint one turn either way; 0 without limits."""
        if self.type(joint) == "continuous":
            return -math.tau, math.tau
        limit = self.joints[joint].find("limit")
        return (0.0, 0.0) if limit is None else (number(limit, "lower"), number(limit, "upper"))

    def axis(self, joint: str) -> Array:
        """The axis in the axes of the child link, of unit length."""
        axis = np.array(numbers(self.joints[joint].find("axis"), "xyz", (1.0, 0.0, 0.0)))
        return axis / max(float(np.linalg.norm(axis)), 1e-12)

    def placement(self, joint: str) -> Array:
        return origin(self.joints[joint])

    def opposed(self, a: str, b: str) -> bool:
        """Whether two joints on one link move in opposite directions."""
        turned = [self.placement(joint)[:3, :3] @ self.axis(joint) for joint in (a, b)]
        return float(np.linalg.norm(turned[0] + turned[1])) < 1e-3


def _end(joint: Element, which: str) -> str:
    found = joint.find(which)
    return "" if found is None else str(found.get("link"))


def number(element: Element, field: str, otherwise: float = 0.0) -> float:
    """A numeric attribute. Raises ProgramError if it is not a finite number."""
    text = element.get(field)
    if text is None:
        return otherwise
    values = urdf_values.parsed(text)
    if values is None or len(values) != 1:
        raise ProgramError(f"<{element.tag} {field}={text!r}> is not a number")
    return values[0]


def numbers(element: Element | None, field: str, otherwise: tuple[float, float, float]) -> tuple[float, float, float]:
    """Three numbers of an attribute. Raises ProgramError if they are not finite numbers."""
    text = None if element is None else element.get(field)
    if element is None or text is None:
        return otherwise
    values = urdf_values.parsed(text)
    if values is None or len(values) != 3:
        raise ProgramError(f"<{element.tag} {field}={text!r}>: three numbers")
    x, y, z = values
    return x, y, z


def origin(element: Element) -> Array:
    """The <origin> of a joint, collision or visual as a 4 x 4 matrix."""
    place = element.find("origin")
    xyz, rpy = numbers(place, "xyz", (0.0, 0.0, 0.0)), numbers(place, "rpy", (0.0, 0.0, 0.0))
    return geometry.to_matrix(geometry.from_rpy(xyz, rpy))
