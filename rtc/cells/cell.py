"""A work-cell as data: arms, seats, objects, places, regions and numbers.

A cell is a YAML file and the robot models that it names. `Cell.load` reads them and embeds the texts of the models, so
that one `encode()`d document is all that a process needs (no shared files, R51). A cell is checked when it is
constructed: all its references and lengths are valid.

Fields that end in `_deg` are degrees, as in the file; properties that end in `_rad` are radians. Poses are seven floats
(see `rtc.robot.geometry`). This module knows no kinematics and does not check reachability.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import msgspec.yaml
from msgspec import Meta

from rtc.cells import model_checks
from rtc.programs.digest import digest
from rtc.protocol.outcomes import ProgramError
from rtc.robot import geometry

CELLS = Path(__file__).parent  # the cells of the project: cells/NAME/cell.yaml

Name = Annotated[str, Meta(pattern=r"^[A-Z][A-Z0-9]*(-[A-Z0-9]+)*$")]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Vec3 = tuple[float, float, float]


class Part(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of all parts of a cell: an unknown field is an error."""


class Frame(Part, frozen=True, kw_only=True):
    """A pose for people: position (m); roll, pitch, yaw (deg) about the fixed axes x, y, z."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> geometry.Array:
        return geometry.from_rpy(self.xyz, [math.radians(n) for n in self.rpy_deg])


# --- shapes --------------------------------------------------------------------------------------------


class Shape(Part, frozen=True, kw_only=True, tag_field="type"):
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


# --- contents of the cell ------------------------------------------------------------------------------


class Gripper(Part, frozen=True, kw_only=True):
    """A parallel gripper: two finger joints of the arm's URDF, each with half the opening."""

    max_opening_m: Positive
    max_force_n: Positive
    speed_m_s: Positive = 0.05
    finger_joints: tuple[str, str] = ("finger_a_slide", "finger_b_slide")
    finger_links: tuple[str, str] = ("finger_a", "finger_b")
    palm_link: str = "palm"


class Arm(Part, frozen=True, kw_only=True):
    name: Name
    end_effector: Name
    urdf: str  # file, relative to the cell's
    srdf: str
    base: Frame  # pose of the URDF's root link, world frame
    joints: list[str]  # names in the URDF, from the base to the hand
    tcp_link: str = "tcp"
    sensor_joint: str = "wrist_ft"  # fixed joint; its reaction is the measured wrench
    home_deg: list[float]
    stow_deg: list[float]
    acceleration_deg_s2: list[Positive]  # the URDF has no field for it
    payload_kg: Positive
    gripper: Gripper

    @property
    def home_rad(self) -> list[float]:
        return [math.radians(n) for n in self.home_deg]

    @property
    def stow_rad(self) -> list[float]:
        return [math.radians(n) for n in self.stow_deg]

    @property
    def acceleration_rad_s2(self) -> list[float]:
        return [math.radians(n) for n in self.acceleration_deg_s2]


class KnownWithin(Part, frozen=True, kw_only=True):
    """Initial pose spread of an object: half-widths along and about each axis of its own frame."""

    xyz_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    rpy_deg: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    @property
    def spread(self) -> list[float]:
        """[x y z roll pitch yaw], m and rad, as in a fact."""
        return [*self.xyz_m, *(math.radians(n) for n in self.rpy_deg)]


class GraspPoint(Part, frozen=True, kw_only=True):
    """A grasp point: the pose of the tcp in the grasp, in the object's axes (tool z approaches, y closes)."""

    name: Name
    frame: Frame
    width_m: Positive  # of the part between the fingers


class Seat(Part, frozen=True, kw_only=True):
    """A fixed place for a module, such as a rack or bay. Shapes are in the seat's own axes."""

    name: Name
    kind: str
    frame: Frame  # world
    module_frame: Frame = Frame()  # pose of a seated module, in the seat's axes
    way_out: Vec3 = (-1.0, 0.0, 0.0)  # direction in which a module leaves; unit vector, seat's axes
    depth_m: NotNegative  # distance along way_out until the module is free
    detent_n: NotNegative = 0.0  # holding force of the catch; 0: no catch
    needs_within: KnownWithin | None = None  # maximum spread of a held module for insertion
    shapes: list[AnyShape] = []


class Object(Part, frozen=True, kw_only=True):
    """An object that can be grasped or, if fixed, an obstacle. `frame`: in the world or in its seat's module frame."""

    name: Name
    kind: str
    frame: Frame = Frame()
    seat: Name | None = None
    known_within: KnownWithin | None = None  # None: the pose is exact
    fixed: bool = False
    mass_kg: Positive = 1.0
    inertia_kg_m2: tuple[Positive, Positive, Positive] | None = None  # about the origin; None: from the shapes
    shapes: list[AnyShape]
    grasp_points: list[GraspPoint] = []

    def grasp_point(self, name: str) -> GraspPoint:
        return _named(self.grasp_points, name, f"grasp point of {self.name}")


class Place(Part, frozen=True, kw_only=True):
    """A named place, with a tcp pose (world frame) or a posture per arm. `object`: goal pose of a carried object."""

    name: Name
    poses: dict[str, Frame] = {}
    joints_deg: dict[str, list[float]] = {}
    object: Frame | None = None

    def joints_rad(self, arm: str) -> list[float] | None:
        degrees = self.joints_deg.get(arm)
        return None if degrees is None else [math.radians(n) for n in degrees]


class Region(Part, frozen=True, kw_only=True):
    """A box in space: a safe work range, or a task region to avoid."""

    name: Name
    frame: Frame  # centre, world
    size_m: tuple[Positive, Positive, Positive]

    def contains(self, point: geometry.Floats) -> bool:
        local = geometry.transform_point(geometry.inverse(self.frame.pose), point)
        return all(abs(x) <= 0.5 * size for x, size in zip(local.tolist(), self.size_m, strict=True))


class Numbers(Part, frozen=True, kw_only=True):
    """Default parameters of this cell, for values that a sentence does not give."""

    neighborhood_radius_m: Positive = 0.15
    approach_m: Positive = 0.10  # the paper's "set distance" before a grasp point
    grasp_tolerance_m: Positive = 0.010
    grasp_tolerance_deg: Positive = 5.0
    search_overrun_m: Positive = 0.010  # beyond the nominal contact
    free_speed_m_s: Positive = 0.25
    near_speed_m_s: Positive = 0.10
    contact_speed_m_s: Positive = 0.02
    acceleration_m_s2: Positive = 1.0
    feel_force_n: Positive = 5.0
    guard_force_n: Positive = 20.0
    joint_margin_deg: NotNegative = 3.0  # IK solutions nearer to a limit are rejected


_T = TypeVar("_T", Arm, Seat, Object, Place, Region, GraspPoint)


class Cell(Part, frozen=True, kw_only=True):
    name: str
    gravity_m_s2: Vec3 = (0.0, 0.0, 0.0)
    arms: list[Arm]
    seats: list[Seat] = []
    objects: list[Object] = []
    places: list[Place] = []
    regions: list[Region] = []
    attitudes: dict[str, Frame] = {}  # of the tcp, world frame; for POSE-DURING-MOTION
    numbers: Numbers = Numbers()
    texts: dict[str, str] = {}  # URDF and SRDF by file name; filled by `load`

    def __post_init__(self) -> None:
        for place, problem in _problems(self):
            raise ValueError(f"$.{place}: {problem}")

    # --- reading and sending ---------------------------------------------------------------------------

    @classmethod
    def load(cls, name_or_path: str | Path) -> Cell:
        """The cell of a name (cells/NAME/cell.yaml) or file, models embedded. Raises ProgramError with the place."""
        path = Path(name_or_path)
        if path.suffix not in (".yaml", ".yml"):
            path = (path if path.is_dir() else CELLS / path) / "cell.yaml"
        if not path.is_file():
            known = ", ".join(sorted(p.parent.name for p in CELLS.glob("*/cell.yaml")))
            raise ProgramError(f"no cell {name_or_path}: there is no file {path}; cells of the project: {known}")
        bare = _decode(path.read_bytes(), str(path))
        texts = dict(bare.texts)
        for n, arm in enumerate(bare.arms):
            for field, file in (("urdf", arm.urdf), ("srdf", arm.srdf)):
                if file not in texts:
                    try:
                        texts[file] = (path.parent / file).read_text(encoding="utf-8")
                    except OSError as error:
                        raise ProgramError(f"{path}: $.arms[{n}].{field}: cannot read {file}: {error}") from error
        cell = msgspec.structs.replace(bare, texts=texts)
        for place, problem in model_checks.problems(cell):
            raise ProgramError(f"{path}: $.{place}: {problem}")
        return cell

    @classmethod
    def from_bytes(cls, document: bytes) -> Cell:
        """The cell of an `encode()`d document, or of any self-contained YAML document. Raises ProgramError."""
        cell = _decode(document, "cell document")
        for n, arm in enumerate(cell.arms):
            for field, file in (("urdf", arm.urdf), ("srdf", arm.srdf)):
                if file not in cell.texts:
                    raise ProgramError(f"cell document: $.arms[{n}].{field}: the text of {file} is not embedded")
        return cell

    def encode(self) -> bytes:
        """One self-contained document (JSON, which is YAML); equal cells give equal bytes."""
        return msgspec.json.encode(self, order="deterministic")

    def digest(self) -> str:
        return digest(self.encode())

    # --- look-ups (KeyError for an unknown name) ----------------------------------------------------------------------

    def arm(self, name: str) -> Arm:
        return _named(self.arms, name, "arm")

    def seat(self, name: str) -> Seat:
        return _named(self.seats, name, "seat")

    def object(self, name: str) -> Object:
        return _named(self.objects, name, "object")

    def place(self, name: str) -> Place:
        return _named(self.places, name, "place")

    def region(self, name: str) -> Region:
        return _named(self.regions, name, "region")

    def urdf(self, arm: str) -> str:
        """The URDF text of an arm."""
        return self.texts[self.arm(arm).urdf]

    def srdf(self, arm: str) -> str:
        return self.texts[self.arm(arm).srdf]

    def seated_pose(self, seat: str) -> geometry.Array:
        """World pose of a module in `seat`."""
        found = self.seat(seat)
        return geometry.compose(found.frame.pose, found.module_frame.pose)

    def object_pose(self, name: str) -> geometry.Array:
        """Initial world pose of an object."""
        found = self.object(name)
        if found.seat is None:
            return found.frame.pose
        return geometry.compose(self.seated_pose(found.seat), found.frame.pose)

    def names(self) -> Iterator[str]:
        """All names in this cell that a sentence may use."""
        for arm in self.arms:
            yield from (arm.name, arm.end_effector)
        for group in (self.seats, self.objects, self.places, self.regions):
            yield from (part.name for part in group)


def _named(parts: Sequence[_T], name: str, what: str) -> _T:
    for part in parts:
        if part.name == name:
            return part
    raise KeyError(f"no {what} {name}; there are {', '.join(p.name for p in parts)}")


def _decode(document: bytes, source: str) -> Cell:
    try:
        if document.startswith(b"{"):  # JSON from `encode`; 20 times faster than the YAML reader
            return msgspec.json.decode(document, type=Cell)
        return msgspec.yaml.decode(document, type=Cell)
    except msgspec.MsgspecError as error:
        raise ProgramError(f"{source}: {error}") from error


def _problems(cell: Cell) -> Iterator[tuple[str, str]]:
    """(place, problem) for faults that the types do not exclude."""
    yield from _repeated_names(cell)
    seats = {seat.name for seat in cell.seats}
    arms = {arm.name: arm for arm in cell.arms}
    taken: dict[str, str] = {}
    for n, arm in enumerate(cell.arms):
        for field in ("home_deg", "stow_deg", "acceleration_deg_s2"):
            if len(getattr(arm, field)) != len(arm.joints):
                yield f"arms[{n}].{field}", f"{len(arm.joints)} joints need as many values"
    for n, seat in enumerate(cell.seats):
        if abs(math.hypot(*seat.way_out) - 1.0) > 1e-6:
            yield f"seats[{n}].way_out", "must be of unit length"
    for n, thing in enumerate(cell.objects):
        if thing.seat is not None and thing.seat not in seats:
            yield f"objects[{n}].seat", f"no seat {thing.seat}; there are {', '.join(sorted(seats))}"
        if thing.seat is not None and taken.setdefault(thing.seat, thing.name) != thing.name:
            yield f"objects[{n}].seat", f"{thing.seat} already holds {taken[thing.seat]}"
        if not thing.shapes:
            yield f"objects[{n}].shapes", "an object needs at least one shape"
    for n, place in enumerate(cell.places):
        for field in ("poses", "joints_deg"):
            for name in getattr(place, field):
                if name not in arms:
                    yield f"places[{n}].{field}.{name}", f"no arm {name}; there are {', '.join(sorted(arms))}"
        for name, joints in place.joints_deg.items():
            if len(joints) != len(arms[name].joints):
                yield f"places[{n}].joints_deg.{name}", f"{len(arms[name].joints)} joints need as many values"


def _repeated_names(cell: Cell) -> Iterator[tuple[str, str]]:
    seen: dict[str, str] = {}
    for group in ("arms", "seats", "objects", "places", "regions"):
        for n, part in enumerate(getattr(cell, group)):
            where = f"{group}[{n}]"
            names = [part.name, part.end_effector] if isinstance(part, Arm) else [part.name]
            for name in names:
                if seen.setdefault(name, where) != where:
                    yield f"{where}.name", f"{name} is already the name of $.{seen[name]}"
    for group in ("seats", "objects"):
        for n, body in enumerate(getattr(cell, group)):
            for field in ("shapes", "grasp_points"):
                pieces = [piece.name for piece in getattr(body, field, [])]
                for m, name in enumerate(pieces):
                    if name in pieces[:m]:
                        yield f"{group}[{n}].{field}[{m}].name", f"{name} is used twice"
