"""What a work-cell consists of: arms, seats, objects, places, regions, cameras, tags, shapes and default numbers.

Fields that end in `_deg` are degrees, as in the file; properties that end in `_rad` are radians. Poses are seven floats
(see `rtc.spatial.geometry`). References between parts are checked by `rtc.model.cells.cell`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import Annotated, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from rtc.model.cells import tag_family
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry

Name = Annotated[str, Meta(pattern=r"^[A-Z][A-Z0-9]*(-[A-Z0-9]+)*$")]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Pixels = Annotated[int, Meta(ge=16, le=4096)]
Vec3 = tuple[float, float, float]
# A joint that turns has a number, in degrees. One that slides has its unit beside it: "0.5 m", "1 m/s2".
Metres = Annotated[str, Meta(pattern=r"^[-+]?[0-9]+(\.[0-9]+)? m$")]
MetresPerS2 = Annotated[str, Meta(pattern=r"^[0-9]+(\.[0-9]+)? m/s2$")]
JointValue = float | Metres
JointAcceleration = Positive | MetresPerS2


FAR = 1e3  # of a frame (m, deg) and of gravity (m/s2), as of the lengths in sentences: larger ones have another unit


class CellPart(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of all parts of a cell: an unknown field is an error."""


class Frame(CellPart, frozen=True, kw_only=True):
    """A pose for people: position (m); roll, pitch, yaw (deg) about the fixed axes x, y, z."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not all(abs(number) <= FAR for number in (*self.xyz, *self.rpy_deg)):  # false for nan too
            raise ValueError(f"a frame has numbers up to {FAR:g} (m, deg)")

    @property
    def pose(self) -> geometry.Array:
        """Read-only."""
        return _pose(self.xyz, self.rpy_deg)


@lru_cache(maxsize=1024)
def _pose(xyz: Vec3, rpy_deg: Vec3) -> geometry.Array:
    pose = geometry.from_rpy(xyz, [math.radians(n) for n in rpy_deg])
    pose.setflags(write=False)
    return pose


# --- shapes --------------------------------------------------------------------------------------------


class Shape(CellPart, frozen=True, kw_only=True, tag_field="type"):
    """One convex piece of a body. Collision messages show `name`: RACK-1 left-wall."""

    name: str
    frame: Frame = Frame()  # in the axes of the body
    friction: NotNegative = 1.0  # coefficient; pybullet multiplies those of the two bodies
    spinning_friction: NotNegative = 0.005  # m; without it, pybullet lets a bar turn in the fingers
    colour: tuple[float, float, float, float] = (0.7, 0.7, 0.72, 1.0)


class Box(Shape, frozen=True, kw_only=True, tag="box"):
    size_m: tuple[Positive, Positive, Positive]


class Cylinder(Shape, frozen=True, kw_only=True, tag="cylinder"):
    """Along z. pybullet grips a cylinder 2 mm too wide: use boxes for parts that are grasped."""

    radius_m: Positive
    length_m: Positive


class Sphere(Shape, frozen=True, kw_only=True, tag="sphere"):
    radius_m: Positive


class Capsule(Shape, frozen=True, kw_only=True, tag="capsule"):
    """Along z. The length excludes the two half spheres."""

    radius_m: Positive
    length_m: Positive


AnyShape = Box | Cylinder | Sphere | Capsule


def radius_m(shape: AnyShape) -> float:
    """Radius of a ball around the middle of the shape that contains it."""
    match shape:
        case Box():
            return 0.5 * math.hypot(*shape.size_m)
        case Sphere():
            return shape.radius_m
        case _:
            return shape.radius_m + 0.5 * shape.length_m


def sides_m(shape: AnyShape) -> Vec3:
    """Sides of the box around the shape, in its axes."""
    match shape:
        case Box():
            return shape.size_m
        case Sphere():
            return (2.0 * shape.radius_m,) * 3
        case _:
            more_m = 2.0 * shape.radius_m if isinstance(shape, Capsule) else 0.0
            return 2.0 * shape.radius_m, 2.0 * shape.radius_m, shape.length_m + more_m


# --- contents of the cell ------------------------------------------------------------------------------


class Gripper(CellPart, frozen=True, kw_only=True):
    """A parallel gripper: two finger joints of the arm's URDF, each with half the opening."""

    max_opening_m: Positive
    max_force_n: Positive
    speed_m_s: Positive = 0.05
    finger_joints: tuple[str, str] = ("finger_a_slide", "finger_b_slide")
    finger_links: tuple[str, str] = ("finger_a", "finger_b")
    palm_link: str = "palm"


class CoupledHand(CellPart, frozen=True, kw_only=True):
    """A hand for the coupler at the end of an arm. While no arm has it, it is the object of this name.

    The arm has a model of its own with each hand. It differs beyond the coupler only."""

    name: Name
    urdf: str  # of the whole arm with this hand
    srdf: str
    tcp_link: str = "tcp"
    payload_kg: Positive  # that the arm carries with this hand
    gripper: Gripper
    coupling: Name = "COUPLING"  # grasp point of the object: there the tcp of the arm without a hand is when it couples


class Arm(CellPart, frozen=True, kw_only=True):
    name: Name
    end_effector: Name
    urdf: str  # file, relative to the cell's
    srdf: str
    base: Frame  # pose of the URDF's root link, world frame
    joints: list[str]  # names in the URDF, from the base to the hand
    tcp_link: str = "tcp"
    sensor_joint: str | None = (
        "wrist_ft"  # fixed joint; its reaction is the measured wrench. null: joint torques give it
    )
    home_deg: list[JointValue]
    stow_deg: list[JointValue]
    acceleration_deg_s2: list[JointAcceleration]  # the URDF has no field for it
    payload_kg: Positive
    gripper: Gripper  # of an arm with a coupler: its jaws
    hands: list[CoupledHand] = []  # that its coupler can lock; it begins without one

    def with_hand(self, name: str) -> Arm:
        """The arm with this hand in its coupler; empty: with none. Raises KeyError."""
        if not name:
            return self
        hand = named(self.hands, name, f"hand of {self.name}")
        return msgspec.structs.replace(
            self,
            urdf=hand.urdf,
            srdf=hand.srdf,
            tcp_link=hand.tcp_link,
            payload_kg=hand.payload_kg,
            gripper=hand.gripper,
        )

    @property
    def with_each_hand(self) -> list[Arm]:
        """The arm without a hand, then with each of its hands."""
        return [self, *(self.with_hand(hand.name) for hand in self.hands)]

    @property
    def home_rad(self) -> list[float]:
        """rad, and m for a joint that slides."""
        return _si(self.home_deg)

    @property
    def stow_rad(self) -> list[float]:
        return _si(self.stow_deg)

    @property
    def acceleration_rad_s2(self) -> list[float]:
        return _si(self.acceleration_deg_s2)


def _si(given: Sequence[float | str]) -> list[float]:
    """Values of joints: rad for a number in degrees, m for a text such as 0.5 m."""
    return [float(n.split()[0]) if isinstance(n, str) else math.radians(n) for n in given]


class KnownWithin(CellPart, frozen=True, kw_only=True):
    """Initial pose spread of an object: half-widths along and about each axis of its own frame."""

    xyz_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    @property
    def spread(self) -> list[float]:
        """[x y z roll pitch yaw], m and rad, as in a fact."""
        return [*self.xyz_m, *(math.radians(n) for n in self.rpy_deg)]


class GraspPoint(CellPart, frozen=True, kw_only=True):
    """A grasp point: the pose of the tcp in the grasp, in the object's axes (tool z approaches, y closes)."""

    name: Name
    frame: Frame
    width_m: Positive  # of the part between the fingers
    round: bool = (
        False  # a round bar along tool x: the hand takes it at the angle about it nearest to its home attitude
    )
    planner: str = ""  # the grasp planner that has added it when the cell was read; empty: the file has it


class Mating(CellPart, frozen=True, kw_only=True):
    """What a plug feels on its way into the socket of a connector: contacts that rub, then a latch. Distances are from
    the mated place, along the `way_out` of the seat. Its `detent_n` is the force with which the latch lets go."""

    connector: Name  # plugs of this name fit
    depth_m: Positive  # from here on the contacts rub, evenly more up to ...
    rub_n: NotNegative  # ... this at the mated place
    latch_m: Positive  # from here on the latch resists, evenly more up to ...
    latch_n: NotNegative  # ... this ...
    click_m: Positive  # ... here; then evenly less, up to the mated place
    holds_n: Positive  # what the latch bears at least; `detent_n` pulls it open

    def __post_init__(self) -> None:
        if not self.click_m < self.latch_m <= self.depth_m:
            raise ValueError(
                "click_m < latch_m <= depth_m: contacts meet before the latch, and the latch before it clicks"
            )

    def rubs_n(self, out_m: float) -> float:
        """Greatest friction of the contacts, this far from the mated place."""
        return self.rub_n * min(1.0, max(0.0, 1.0 - out_m / self.depth_m))

    def latches_n(self, out_m: float) -> float:
        """Force of the latch against the way in."""
        if out_m >= self.click_m:
            return self.latch_n * max(0.0, (self.latch_m - out_m) / (self.latch_m - self.click_m))
        return self.latch_n * max(0.0, out_m / self.click_m)

    @property
    def most_n(self) -> float:
        """Greatest force against the way in."""
        return self.latch_n + self.rubs_n(self.click_m)

    @property
    def gives_way_n_m(self) -> float:
        """By how much the force of the latch falls on the way from the click to the mated place."""
        return self.latch_n / self.click_m


class Seat(CellPart, frozen=True, kw_only=True):
    """A fixed place for a module, such as a rack or bay. Shapes are in the seat's own axes."""

    name: Name
    kind: str
    frame: Frame  # world
    module_frame: Frame = Frame()  # pose of a seated module, in the seat's axes
    way_out: Vec3 = (-1.0, 0.0, 0.0)  # direction in which a module leaves; unit vector, seat's axes
    depth_m: NotNegative  # distance along way_out until the module is free
    detent_n: NotNegative = 0.0  # holding force of the catch; 0: no catch
    detent_nm: Positive | None = None  # torque with which it holds the attitude; None: `detent_n` at a lever of 1 m
    needs_within: KnownWithin | None = None  # maximum spread of a held module for insertion
    mating: Mating | None = None  # the seat is the socket of a connector
    bolts: list[Name] = []  # objects with a thread: a module in the seat is fastened until all are turned out
    mounted_on: Name | None = None  # a fixed object: where that is, the seat goes with it
    shapes: list[AnyShape] = []

    def __post_init__(self) -> None:
        if self.mating is not None and not (
            self.mating.depth_m <= self.depth_m and self.mating.holds_n < self.detent_n
        ):
            raise ValueError(
                "a socket needs mating.depth_m of at most its depth_m, and mating.holds_n below its detent_n"
            )


class Hinge(CellPart, frozen=True, kw_only=True):
    """A hinge between an object and what it is `mounted_on`, or the world. It goes through the object's origin. `frame`
    of the object: at angle 0."""

    axis: Vec3 = (0.0, 0.0, 1.0)  # unit vector, object's axes; a positive angle turns about it
    range_deg: tuple[float, float]  # the stops
    at_deg: float = 0.0  # initial angle
    friction_nm: NotNegative = 0.0

    @property
    def range_rad(self) -> tuple[float, float]:
        return math.radians(self.range_deg[0]), math.radians(self.range_deg[1])


class Spindle(CellPart, frozen=True, kw_only=True):
    """The spindle of a driver. `frame`: its tip in the object's axes; z points out of the tool, into the bolt."""

    frame: Frame
    most_nm: Positive
    most_rad_s: Positive


class Thread(CellPart, frozen=True, kw_only=True):
    """The thread of a bolt, right-handed. The origin of the object is the middle of its head; z points outwards."""

    pitch_m: Positive  # per turn
    turns: Positive  # from tight to free
    breakaway_nm: Positive  # to loosen it when it is tight
    running_nm: NotNegative = 0.3


class Object(CellPart, frozen=True, kw_only=True):
    """An object that can be grasped or, if fixed, an obstacle. `frame`: in the world or in its seat's module frame."""

    name: Name
    kind: str
    frame: Frame = Frame()
    seat: Name | None = None
    mounted_on: Name | None = None  # a fixed object that carries this one, which is fixed or has a hinge
    # None: the pose is exact; "unknown": it is a guess, and a camera or SET must state it before a step relies on it
    known_within: KnownWithin | Literal["unknown"] | None = None
    fixed: bool = False
    hinge: Hinge | None = None  # a door or lid: it turns about it, and goes nowhere else
    spindle: Spindle | None = None  # a driver
    thread: Thread | None = None  # a bolt; it is fixed but for its thread
    plug: Name | None = None  # the connector whose plug it is
    mass_kg: Positive = 1.0
    # About the origin; None: from the shapes. Of an object with a hinge: about its centre of mass.
    inertia_kg_m2: tuple[Positive, Positive, Positive] | None = None
    centre_of_mass_m: Vec3 = (0.0, 0.0, 0.0)  # of an object with a hinge; others have it in their origin
    shapes: list[AnyShape]
    grasp_points: list[GraspPoint] = []

    @property
    def unsurveyed(self) -> bool:
        return self.known_within == "unknown"

    @property
    def surveyed_spread(self) -> list[float] | None:
        """The initial spread of its pose; None: exact, or unknown."""
        return self.known_within.spread if isinstance(self.known_within, KnownWithin) else None

    def grasp_point(self, name: str) -> GraspPoint:
        return named(self.grasp_points, name, f"grasp point of {self.name}")


class Place(CellPart, frozen=True, kw_only=True):
    """A named place, with a tcp pose (world frame) or a posture per arm."""

    name: Name
    poses: dict[str, Frame] = {}
    joints_deg: dict[str, list[JointValue]] = {}

    def joints_rad(self, arm: str) -> list[float] | None:
        given = self.joints_deg.get(arm)
        return None if given is None else _si(given)

    def without(self, arms: Collection[str]) -> Place:
        """The place without the poses and postures of these arms."""
        poses = {arm: pose for arm, pose in self.poses.items() if arm not in arms}
        joints = {arm: values for arm, values in self.joints_deg.items() if arm not in arms}
        return msgspec.structs.replace(self, poses=poses, joints_deg=joints)


class Region(CellPart, frozen=True, kw_only=True):
    """A box in space: a safe work range, or a task region to avoid."""

    name: Name
    frame: Frame  # centre, world
    size_m: tuple[Positive, Positive, Positive]

    def contains(self, point: geometry.Floats) -> bool:
        local = geometry.transform_point(geometry.inverse(self.frame.pose), point)
        return all(abs(x) <= 0.5 * size for x, size in zip(local.tolist(), self.size_m, strict=True))


class Maintained(CellPart, frozen=True, kw_only=True):
    """What each MAINTAIN item means in this cell when the sentence gives no argument. None: it is refused then."""

    safe_work_range: Name | None = None  # a region
    avoid_task_region: Name | None = None  # a region
    avoid_neighbors_m: Positive | None = None
    pose_during_motion: Name | None = None  # an attitude
    speed_m_s: Positive | None = None
    force_limit_n: Positive | None = None
    torque_limit_nm: Positive | None = None
    grip_force_n: Positive | None = None
    stiffness_n_m: Positive | None = None
    time_limit_s: Positive | None = None

    def meaning(self, slot: str) -> tuple[str, str | float] | None:
        """(unit, value) of an item such as SPEED; the unit `name` for a region or an attitude. None: no meaning."""
        field, unit = MAINTAINED.get(slot, ("", ""))
        value = getattr(self, field, None)
        return None if value is None else (unit, value)


#: item -> field of `Maintained`, and the unit of its value
MAINTAINED: dict[str, tuple[str, str]] = {
    "SAFE-WORK-RANGE": ("safe_work_range", "name"),
    "AVOID-TASK-REGION": ("avoid_task_region", "name"),
    "AVOID-NEIGHBORS": ("avoid_neighbors_m", "m"),
    "POSE-DURING-MOTION": ("pose_during_motion", "name"),
    "SPEED": ("speed_m_s", "m/s"),
    "FORCE-LIMIT": ("force_limit_n", "N"),
    "TORQUE-LIMIT": ("torque_limit_nm", "N.m"),
    "GRIP-FORCE": ("grip_force_n", "N"),
    "STIFFNESS": ("stiffness_n_m", "N/m"),
    "TIME-LIMIT": ("time_limit_s", "s"),
}


class Camera(CellPart, frozen=True, kw_only=True):
    """A camera without distortion. `arm`: whose hand carries it; then all axes are those of the tcp, else the world's.
    Its own axes: x right, y down in the picture, z forward."""

    name: Name
    arm: Name | None = None
    xyz: Vec3
    looks_at: Vec3  # a point on the optical axis
    up: Vec3 = (0.0, 0.0, 1.0)  # direction that points upwards in the picture
    field_of_view_deg: Annotated[float, Meta(ge=2.0, le=150.0)] = 45.0  # vertical
    size_px: tuple[Pixels, Pixels] = (640, 480)  # width, height
    noise: Annotated[float, Meta(ge=0.0, le=255.0)] = 0.0  # standard deviation of a pixel; white is 255
    exposure: Annotated[float, Meta(ge=0.0, le=100.0)] = 1.0  # factor of the brightness; 0: blind

    @property
    def pose(self) -> geometry.Array:
        """Pose of the camera's axes in the axes of the tcp, or in the world frame. ValueError if they are undefined."""
        forward = np.subtract(self.looks_at, self.xyz)
        right = np.cross(forward, self.up)
        if not np.linalg.norm(right) > 1e-6 * np.linalg.norm(forward) * np.linalg.norm(self.up):
            raise ValueError(f"{self.name} has no attitude: `looks_at` must differ from `xyz`, and not lie along `up`")
        matrix = np.eye(4)
        matrix[:3, 0] = right / np.linalg.norm(right)
        matrix[:3, 2] = forward / np.linalg.norm(forward)
        matrix[:3, 1] = np.cross(matrix[:3, 2], matrix[:3, 0])
        matrix[:3, 3] = self.xyz
        return geometry.from_matrix(matrix)


class Tag(CellPart, frozen=True, kw_only=True):
    """An AprilTag of the family 36h11 on an object or seat. `frame`: the tag's centre in the axes of that body; x to
    the right and y upwards as one reads it, z out of the surface."""

    id: Annotated[int, Meta(ge=0, lt=tag_family.COUNT)]
    body: Name
    frame: Frame
    size_m: Positive  # edge of the black square; the white border adds a quarter


class Numbers(CellPart, frozen=True, kw_only=True):
    """Default parameters of this cell, for values that a sentence does not give."""

    neighborhood_radius_m: Positive = 0.15
    approach_m: Positive = 0.10  # the paper's "set distance" before a grasp point
    free_speed_m_s: Positive = 0.25
    near_speed_m_s: Positive = 0.10
    contact_speed_m_s: Positive = 0.02
    acceleration_m_s2: Positive = 1.0
    feel_force_n: Positive = 5.0
    guard_force_n: Positive = 20.0
    joint_margin_deg: NotNegative = 3.0  # IK solutions nearer to a limit are rejected; of a slide 5 mm for 3 deg
    # Creep of an object in the hand, along and about each axis, per second in which the arm moves; at rest there is
    # none (decision 0128). In the simulation, at the module's origin, motions of 2 to 21 s: 0.005 to 0.061 mm/s and
    # 0.003 to 0.014 deg/s; with 1.5 times the mass and 0.6 of the friction 0.068 to 0.084 mm/s.
    creep_m_s: NotNegative = 0.00008
    creep_rad_s: NotNegative = 0.0004
    # Half-widths of a pose that a person states with SET, along and about each axis.
    stated_m: NotNegative = 0.005
    stated_rad: NotNegative = 0.035
    pictures: Annotated[int, Meta(ge=1)] = 2  # of each camera that looks for a body at rest


Named = TypeVar("Named", Arm, CoupledHand, Seat, Object, Place, Region, GraspPoint, Camera)


def named(parts: Sequence[Named], name: str, what: str) -> Named:
    for part in parts:
        if part.name == name:
            return part
    raise KeyError(unknown(what, name, (part.name for part in parts)))
