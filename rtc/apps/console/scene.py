"""All bodies of a cell for a page: names, shapes and colours once, then their poses. Pure.

A body is a link of an arm, a seat or an object. Poses are [x y z qx qy qz qw] (m, world frame), in the order of
`SceneBodies.rows`. Shapes are primitives or triangles, so that a page needs no URDF.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import msgspec

from rtc.apps.observers.frames import WORLD, ArmFrames
from rtc.drawing.scene import SceneView
from rtc.model.cells import urdf
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import AnyShape, Box, Sphere
from rtc.model.cells.urdf import Urdf
from rtc.spatial import geometry

GREY = (0.6, 0.62, 0.66, 1.0)
NOWHERE = [math.nan] * 7


class Body(msgspec.Struct, frozen=True, kw_only=True):
    """One rigid body. `owner`: the arm of a link; otherwise its own name."""

    name: str
    group: str  # arm, seat or object
    owner: str
    shapes: list[dict[str, Any]]


class SceneBodies:
    """The bodies of one cell."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self._arms = {arm.name: _Links(cell, arm.name) for arm in cell.arms}
        self.rows: list[Body] = [row for arm in self._arms.values() for row in arm.bodies()]
        self.rows += [_of_shapes(seat.name, "seat", seat.shapes) for seat in cell.seats]
        self.rows += [_of_shapes(thing.name, "object", thing.shapes) for thing in cell.objects]

    def poses(self, scene: SceneView, only: Collection[str] | None = None) -> list[float]:
        """Seven numbers for each body, one after another. What the scene lacks is as the cell begins.

        `only`: arms, seats and objects whose bodies get poses; those of others are not numbers."""
        found: list[float] = []
        for arm in self.cell.arms:
            half = 0.5 * arm.gripper.max_opening_m
            joints, fingers = scene.joints.get(arm.name, arm.home_rad), scene.fingers.get(arm.name, [half, half])
            for pose in self._arms[arm.name].poses(joints, fingers):
                found += pose
        for seat in self.cell.seats:
            found += scene.seats.get(seat.name) or seat.frame.pose.tolist()
        for thing in self.cell.objects:
            found += scene.poses.get(thing.name) or self.cell.object_pose(thing.name).tolist()
        for n, row in enumerate(self.rows if only is not None else ()):
            if only is not None and row.owner not in only:
                found[7 * n : 7 * n + 7] = NOWHERE
        return found


class _Links:
    """The links of one arm in the order of their kinematics: a parent before its children."""

    def __init__(self, cell: Cell, arm: str) -> None:
        self._arm, self._cell = cell.arm(arm), cell
        self._frames = ArmFrames(cell, arm)
        self._robot = Urdf(ET.fromstring(cell.urdf(arm)))
        self._names = sorted(self._robot.links, key=lambda link: len(self._robot.way_to(link)))

    def bodies(self) -> Iterator[Body]:
        materials = {str(one.get("name")): one for one in self._robot.robot.findall("material")}
        for link in self._names:
            shapes = list(_link_shapes(self._robot.links[link], self._cell.texts, materials))
            yield Body(name=f"{self._arm.name}/{link}", group="arm", owner=self._arm.name, shapes=shapes)

    def poses(self, joints: Sequence[float], fingers: Sequence[float]) -> list[list[float]]:
        """World poses of all links. `joints`: rad, m for those that slide; `fingers`: m."""
        arm = self._arm
        values = {f"{arm.name}/{name}": value for name, value in zip(arm.joints, joints, strict=True)}
        values |= {f"{arm.name}/{name}": value for name, value in zip(arm.gripper.finger_joints, fingers, strict=True)}
        steps = {child: (parent, pose) for parent, child, pose in self._frames.transforms(values)}
        world: dict[str, geometry.Array] = {}
        for link in self._names:
            parent, pose = steps[f"{arm.name}/{link}"]
            world[f"{arm.name}/{link}"] = pose if parent == WORLD else geometry.compose(world[parent], pose)
        return [world[f"{arm.name}/{link}"].tolist() for link in self._names]


def _of_shapes(name: str, group: str, shapes: Sequence[AnyShape]) -> Body:
    return Body(name=name, group=group, owner=name, shapes=[_primitive(shape) for shape in shapes])


def _primitive(shape: AnyShape) -> dict[str, Any]:
    kind = type(shape).__name__.lower()
    match shape:
        case Box():
            size = list(shape.size_m)
        case Sphere():
            size = [shape.radius_m]
        case _:
            size = [shape.radius_m, shape.length_m]
    return {"type": kind, "size": size, "pose": shape.frame.pose.tolist(), "colour": list(shape.colour)}


def _link_shapes(link: Element, texts: Mapping[str, str], materials: Mapping[str, Element]) -> Iterator[dict[str, Any]]:
    """What is seen of a link. If a mesh of it is not in the cell, its collision shapes instead."""
    visuals = link.findall("visual")
    meshes = [str(mesh.get("filename")) for visual in visuals for mesh in visual.iter("mesh")]
    drawn = visuals if visuals and all(file in texts for file in meshes) else link.findall("collision")
    colours = [_colour(visual, materials) for visual in visuals] or [list(GREY)]
    for n, element in enumerate(drawn):
        geometry_of = element.find("geometry")
        if geometry_of is not None and len(geometry_of):
            pose = geometry.from_matrix(urdf.origin(element)).tolist()
            yield {**_urdf_shape(geometry_of[0], texts), "pose": pose, "colour": colours[min(n, len(colours) - 1)]}


def _urdf_shape(shape: Element, texts: Mapping[str, str]) -> dict[str, Any]:
    match shape.tag:
        case "box":
            return {"type": "box", "size": [float(n) for n in str(shape.get("size")).split()]}
        case "sphere":
            return {"type": "sphere", "size": [urdf.number(shape, "radius")]}
        case "mesh":
            return {"type": "mesh", **_triangles(texts.get(str(shape.get("filename")), ""))}
        case kind:  # cylinder, capsule
            return {"type": kind, "size": [urdf.number(shape, "radius"), urdf.number(shape, "length")]}


def _triangles(text: str) -> dict[str, list[float] | list[int]]:
    """Vertices (m) and triangles of an OBJ text with lines `v x y z` and `f a b c`."""
    lines = [line.split() for line in text.splitlines()]
    points = [round(float(n), 5) for words in lines if words[:1] == ["v"] for n in words[1:4]]
    corners = [int(n.partition("/")[0]) - 1 for words in lines if words[:1] == ["f"] for n in words[1:4]]
    return {"vertices": points, "faces": corners}


def _colour(visual: Element, materials: Mapping[str, Element]) -> list[float]:
    material = visual.find("material")
    if material is None:
        return list(GREY)
    colour = material.find("color")
    if colour is None and str(material.get("name")) in materials:
        colour = materials[str(material.get("name"))].find("color")
    return list(GREY) if colour is None else [float(n) for n in str(colour.get("rgba")).split()]
