"""The collision model of a cell: arms, seats, objects and regions as pinocchio geometry, and their collision pairs.

This module builds the model; `rtc.model.robot.collision` queries it. Each piece has an owner (RIGHT-ARM, RACK-1,
MACS-OLD, a region) and a name, so that a message reads "RIGHT-ARM forearm collides with RACK-1 left-wall".
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import coal
import pinocchio as pin

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.model.robot import hulls
from rtc.protocol.outcomes import ProgramError
from rtc.spatial.geometry import Floats

#: shape of a cell -> its geometry for coal
COAL_SHAPES: dict[type, Callable[[Any], coal.ShapeBase]] = {
    parts.Box: lambda s: coal.Box(*s.size_m),
    parts.Cylinder: lambda s: coal.Cylinder(s.radius_m, s.length_m),
    parts.Sphere: lambda s: coal.Sphere(s.radius_m),
    parts.Capsule: lambda s: coal.Capsule(s.radius_m, s.length_m),
}


@dataclass(frozen=True)
class CollisionPiece:
    """One convex piece, at the same index as its geometry object."""

    owner: str
    part: str
    kind: str  # "arm", "base" (of an arm, moved by none of its joints), "fixed", "movable", "region"
    in_owner: pin.SE3  # in the owner's axes; of an arm: in the axes of the parent joint

    @property
    def label(self) -> str:
        return f"{self.owner} {self.part}"


@dataclass
class ArmSlots:
    """Indices of one arm in the model of the whole cell."""

    joints: list[int]  # indices in the configuration vector, in joint order
    fingers: list[int]
    hand_joint: int  # id of the joint that carries the hand
    tcp: pin.SE3  # in the axes of that joint
    hand_links: set[str]


@dataclass
class Bodies:
    model: pin.Model
    geometry: pin.GeometryModel
    pieces: list[CollisionPiece]
    pairs: list[tuple[int, int]]  # in the order of `geometry.collisionPairs`
    arms: dict[str, ArmSlots] = field(default_factory=dict)


def build(cell: cells.Cell) -> Bodies:
    """The collision model of a cell, objects at their initial poses. Raises ProgramError for a missing joint."""
    model, geometry = pin.Model(), pin.GeometryModel()
    pieces: list[CollisionPiece] = []
    slots: dict[str, ArmSlots] = {}
    disabled: set[frozenset[str]] = set()
    for arm in cell.arms:
        text = _prefixed(cell.urdf(arm.name), arm.name)
        own = pin.buildModelFromXML(text)
        shapes = hulls.shapes(own, text, cell.texts)
        model, geometry = pin.appendModel(model, own, geometry, shapes, 0, se3(arm.base.pose))
        disabled |= _disabled_pairs(cell.srdf(arm.name), arm.name)
    for item in geometry.geometryObjects:
        owner, part = item.name.rsplit("_", 1)[0].split(" ", 1)  # pinocchio adds _0, _1 to the link's name
        kind = "arm" if item.parentJoint > 0 else "base"
        pieces.append(CollisionPiece(owner, part, kind, item.placement.copy()))
    for arm in cell.arms:
        slots[arm.name] = _slots(model, arm)
    for seat in cell.seats:
        _add(geometry, pieces, seat.name, "fixed", seat.frame.pose, seat.shapes)
    for thing in cell.objects:
        kind = "fixed" if thing.fixed else "movable"
        _add(geometry, pieces, thing.name, kind, cell.object_pose(thing.name), thing.shapes)
    for region in cell.regions:
        box = parts.Box(name="region", size_m=region.size_m)
        _add(geometry, pieces, region.name, "region", region.frame.pose, [box])
    pairs = [pair for pair in _candidates(pieces) if not _is_disabled(pieces, pair, disabled)]
    for pair in pairs:
        geometry.addCollisionPair(pin.CollisionPair(*pair))
    # pinocchio reorders the pairs; `pairs` must have its order.
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    return Bodies(model, geometry, pieces, pairs, slots)


def _add(
    geometry: pin.GeometryModel,
    pieces: list[CollisionPiece],
    owner: str,
    kind: str,
    pose: Floats,
    shapes: list[parts.AnyShape],
) -> None:
    for shape in shapes:
        piece = CollisionPiece(owner, shape.name, kind, se3(shape.frame.pose))
        solid = COAL_SHAPES[type(shape)](shape)
        geometry.addGeometryObject(pin.GeometryObject(piece.label, 0, se3(pose) * piece.in_owner, solid))
        pieces.append(piece)


def _candidates(pieces: list[CollisionPiece]) -> list[tuple[int, int]]:
    """The relevant pairs: an arm with any body, a movable object with any other body."""
    moving, arms = ("arm", "movable"), ("arm", "base")
    return [
        (i, j)
        for i, a in enumerate(pieces)
        for j, b in enumerate(pieces[i + 1 :], i + 1)
        if (a.kind in moving or b.kind in moving) and (a.owner != b.owner or a.kind in arms)
    ]


def _is_disabled(pieces: list[CollisionPiece], pair: tuple[int, int], disabled: set[frozenset[str]]) -> bool:
    a, b = (pieces[n] for n in pair)
    arms = ("arm", "base")
    return a.kind in arms and b.kind in arms and (a.label == b.label or frozenset((a.label, b.label)) in disabled)


def _slots(model: pin.Model, arm: parts.Arm) -> ArmSlots:
    def place(joint: str) -> int:
        name = f"{arm.name} {joint}"
        if not model.existJointName(name):
            raise ProgramError(f"{arm.name}: its URDF has no joint {joint}")
        return int(model.joints[model.getJointId(name)].idx_q)

    tcp = model.frames[model.getFrameId(f"{arm.name} {arm.tcp_link}")]
    return ArmSlots(
        joints=[place(joint) for joint in arm.joints],
        fingers=[place(joint) for joint in arm.gripper.finger_joints],
        hand_joint=int(tcp.parentJoint),
        tcp=tcp.placement.copy(),
        hand_links={arm.gripper.palm_link, *arm.gripper.finger_links},
    )


def _prefixed(urdf: str, name: str) -> str:
    """The URDF with the arm's name before each link and joint name, so that names are unique in one model."""
    root = ET.fromstring(urdf)
    for element in root.iter():
        for tag, attribute in (("link", "name"), ("joint", "name"), ("parent", "link"), ("child", "link")):
            if element.tag == tag and attribute in element.attrib:
                element.set(attribute, f"{name} {element.get(attribute)}")
    return ET.tostring(root, encoding="unicode")


def _disabled_pairs(srdf: str, name: str) -> set[frozenset[str]]:
    rows = ET.fromstring(srdf).iter("disable_collisions")
    return {frozenset((f"{name} {row.get('link1')}", f"{name} {row.get('link2')}")) for row in rows}


def se3(pose: Floats) -> pin.SE3:
    return pin.XYZQUATToSE3(list(pose))
