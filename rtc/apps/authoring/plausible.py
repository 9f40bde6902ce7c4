"""Figures of a cell or a URDF that are possible, but hardly meant: a wrong unit, a power of ten, a slipped digit. Pure.

Each figure has a range in one table, with the unit and what lies at its ends. A figure outside gives a warning. Only
what no body can have is an error. Those of the cells that come with rtc are inside (a test).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from rtc.apps.authoring.inertias import GYRATION
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Box, Capsule, Cylinder, Object, Seat, Sphere
from rtc.model.cells.urdf import number
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry


class Range(NamedTuple):
    """The least and the greatest plausible value, in this unit; what has them."""

    least: float
    most: float
    unit: str
    why: str


_SIZE = Range(1e-4, 100.0, "m", "a foil; a hall")
_FORCE = Range(0.0, 1e5, "N", "none; a press of ten tons")
_TORQUE = Range(0.0, 1e5, "N.m", "none; the first joint of the greatest robots")
_SPEED = Range(1e-4, 20.0, "m/s", "a creep; a delta robot")

#: type and field of a part of a cell -> its range
RANGES = {
    "Arm.acceleration_deg_s2": Range(0.01, 1e5, "deg/s2", "a space arm of many tons; a delta robot"),
    "Arm.payload_kg": Range(0.001, 1e5, "kg", "a micromanipulator; an arm of a space station"),
    "CoupledHand.payload_kg": Range(0.001, 1e5, "kg", "a micromanipulator; an arm of a space station"),
    "Gripper.max_opening_m": Range(1e-4, 3.0, "m", "a micromanipulator; a hand for car bodies"),
    "Gripper.max_force_n": Range(1e-3, 1e5, "N", "a micromanipulator; a forging manipulator"),
    "Gripper.speed_m_s": _SPEED,
    "Box.size_m": _SIZE,
    "Cylinder.radius_m": _SIZE,
    "Cylinder.length_m": _SIZE,
    "Sphere.radius_m": _SIZE,
    "Capsule.radius_m": _SIZE,
    "Capsule.length_m": Range(0.0, 100.0, "m", "a ball; a hall"),
    "Shape.friction": Range(0.0, 10.0, "", "none; adhesive rubber"),
    "Shape.spinning_friction": Range(0.0, 1.0, "m", "none; a sole of a metre"),
    "KnownWithin.xyz_m": Range(0.0, 10.0, "m", "exact; anywhere in the cell"),
    "KnownWithin.rpy_deg": Range(0.0, 180.0, "deg", "exact; any attitude"),
    "GraspPoint.width_m": Range(1e-4, 3.0, "m", "a foil; a car body"),
    "Seat.depth_m": Range(0.0, 10.0, "m", "an open table; a launch tube"),
    "Seat.detent_n": Range(0.0, 1e4, "N", "no catch; one that no hand of a robot overcomes"),
    "Seat.detent_nm": Range(0.0, 1e4, "N.m", "no catch; one that no hand of a robot overcomes"),
    "Mating.depth_m": Range(1e-4, 1.0, "m", "a contact of a telephone; a docking port"),
    "Mating.rub_n": Range(0.0, 1e4, "N", "none; a connector that a screw pulls in"),
    "Mating.latch_m": Range(1e-5, 1.0, "m", "a contact of a telephone; a docking port"),
    "Mating.latch_n": Range(0.0, 1e4, "N", "no latch; one that no hand of a robot overcomes"),
    "Mating.click_m": Range(1e-6, 1.0, "m", "a contact of a telephone; a docking port"),
    "Mating.holds_n": Range(1e-3, 1e4, "N", "a contact of a telephone; a docking port"),
    "Hinge.friction_nm": Range(0.0, 1e4, "N.m", "none; a vault door"),
    "Spindle.most_nm": Range(1e-4, 1e4, "N.m", "a watch screw; a flange of a turbine"),
    "Spindle.most_rad_s": Range(1e-3, 1e4, "rad/s", "a turn in two hours; a dental drill"),
    "Thread.pitch_m": Range(5e-5, 0.1, "m", "a watch screw; a lead screw"),
    "Thread.turns": Range(0.05, 1000.0, "turns", "a bayonet; a metre of fine thread"),
    "Thread.breakaway_nm": Range(1e-5, 1e4, "N.m", "a watch screw; a flange of a turbine"),
    "Thread.running_nm": Range(0.0, 1e4, "N.m", "none; a flange of a turbine"),
    "Object.mass_kg": Range(1e-6, 1e6, "kg", "a grain of sand; a space station"),
    "Region.size_m": Range(1e-3, 1000.0, "m", "a gap; an airfield"),
    "Camera.noise": Range(0.0, 50.0, "of 255", "none; a picture without contours"),
    "Tag.size_m": Range(1e-3, 2.0, "m", "of an insect; of a landing pad"),
    "Maintained.avoid_neighbors_m": Range(0.0, 10.0, "m", "touching; the cell"),
    "Maintained.force_limit_n": _FORCE,
    "Maintained.grip_force_n": _FORCE,
    "Maintained.speed_m_s": _SPEED,
    "Maintained.stiffness_n_m": Range(0.1, 1e7, "N/m", "a thread; a machine tool"),
    "Maintained.time_limit_s": Range(0.1, 1e6, "s", "a blink; ten days"),
    "Maintained.torque_limit_nm": _TORQUE,
    "Numbers.neighborhood_radius_m": _SIZE,
    "Numbers.approach_m": _SIZE,
    "Numbers.free_speed_m_s": _SPEED,
    "Numbers.near_speed_m_s": _SPEED,
    "Numbers.contact_speed_m_s": _SPEED,
    "Numbers.acceleration_m_s2": Range(1e-4, 1000.0, "m/s2", "a space arm of many tons; a delta robot"),
    "Numbers.feel_force_n": _FORCE,
    "Numbers.guard_force_n": _FORCE,
    "Numbers.pictures": Range(1.0, 1000.0, "", "one; more than a look lasts"),
    "Numbers.stated_m": Range(1e-5, 1.0, "m", "a measuring machine; a guess by eye"),
    "Numbers.stated_rad": Range(1e-5, 1.0, "rad", "a measuring machine; a guess by eye"),
    "Numbers.joint_margin_deg": Range(0.0, 90.0, "deg", "none; a quarter turn"),
    "Numbers.creep_m_s": Range(0.0, 0.1, "m/s", "none; a hand that loses its load"),
    "Numbers.creep_rad_s": Range(0.0, 1.0, "rad/s", "none; a hand that loses its load"),
}

#: type of a joint and attribute of a URDF -> its range
OF_JOINT = {
    ("revolute", "effort"): Range(1e-3, 1e5, "N.m", "a micromanipulator; the first joint of the greatest robots"),
    ("revolute", "velocity"): Range(1e-4, 200.0, "rad/s", "a space arm of many tons; a wrist at 2,000 turns a minute"),
    ("revolute", "damping"): Range(0.0, 1e4, "N.m.s/rad", "none; more than any motor turns"),
    ("revolute", "friction"): Range(0.0, 1e4, "N.m", "none; more than any motor turns"),
    ("prismatic", "effort"): Range(1e-3, 1e6, "N", "a micromanipulator; a press"),
    ("prismatic", "velocity"): Range(1e-5, 20.0, "m/s", "a fine stage; a linear motor"),
    ("prismatic", "damping"): Range(0.0, 1e5, "N.s/m", "none; more than any motor moves"),
    ("prismatic", "friction"): Range(0.0, 1e5, "N", "none; more than any motor moves"),
}
SLIDING = Range(1e-4, 1000.0, "m/s2", "a space arm of many tons; a delta robot")  # acceleration of a joint that slides
POINT = 0.01  # least plausible radius of gyration, as a share of the extent of a body: all mass in a point
HIDDEN_M = 0.002  # a tag this far below the surface of its body is not seen

Row = tuple[str, str, Literal["error", "warning"], str]  # where, problem, severity, expected


def of_cell(cell: Cell) -> Iterator[Row]:
    """The figures of a cell that are not plausible."""
    for field in (name for name in cell.__struct_fields__ if name != "texts"):
        yield from _figures(getattr(cell, field), field, "")
    for n, thing in enumerate(cell.objects):
        yield from ((f"objects[{n}].inertia_kg_m2", *fault) for fault in _inertia(thing))
    for n, tag in enumerate(cell.tags):
        bodies: list[Object | Seat] = [*cell.objects, *cell.seats]
        body = next((part for part in bodies if part.name == tag.body), None)
        deep_m = max((_depth_m(shape, tag.frame.xyz) for shape in body.shapes), default=0.0) if body else 0.0
        if deep_m > HIDDEN_M:
            words = f"tag {tag.id} is {1000 * deep_m:.0f} mm inside {tag.body}: no camera sees it"
            yield f"tags[{n}].frame", words, "warning", "a place on the surface"


def of_joint(joint: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """(problem, expected) of the figures of a moving joint of a URDF."""
    kind = "prismatic" if joint.get("type") == "prismatic" else "revolute"
    for tag, names in (("limit", ("effort", "velocity")), ("dynamics", ("damping", "friction"))):
        element = joint.find(tag)
        if element is None:
            continue
        for name in names:
            try:
                value, row = number(element, name) if element.get(name) else 0.0, OF_JOINT[kind, name]
            except ProgramError:
                continue  # stated as an error
            if value > 0.0 and not row.least <= value <= row.most:  # what is not above 0 is stated elsewhere
                yield f"its {name} is {value:g} {row.unit}", expected(row)


def expected(row: Range) -> str:
    least, most = row.why.split("; ")
    return f"{row.least:g} ({least}) to {row.most:g} {row.unit}".rstrip() + f" ({most})"


def _figures(part: Any, where: str, field: str) -> Iterator[Row]:
    """`field`: the type and the field that has the value."""
    if isinstance(part, msgspec.Struct):
        for name in part.__struct_fields__:
            kind = next((k.__name__ for k in type(part).__mro__ if f"{k.__name__}.{name}" in RANGES), "")
            yield from _figures(getattr(part, name), f"{where}.{name}", f"{kind}.{name}")
    elif isinstance(part, dict):
        for name, value in part.items():
            yield from _figures(value, f"{where}.{name}", field)
    elif isinstance(part, list | tuple):
        for n, value in enumerate(part):
            yield from _figures(value, f"{where}[{n}]", field)
    elif field in RANGES and part is not None:
        row = SLIDING if isinstance(part, str) else RANGES[field]
        value = float(part.split()[0]) if isinstance(part, str) else float(part)
        if not row.least <= value <= row.most:
            yield where, f"{value:g} {row.unit}".rstrip() + " is not plausible", "warning", expected(row)


def _inertia(thing: Object) -> Iterator[tuple[str, Literal["error", "warning"], str]]:
    if thing.inertia_kg_m2 is None:
        return
    a, b, c = sorted(thing.inertia_kg_m2)
    if a + b < c * (1.0 - 1e-6):
        words = f"a rigid body cannot have the inertia {a:.3g}, {b:.3g}, {c:.3g} kg m2"
        yield words, "error", "moments of which none is above the sum of the others"
        return
    extent_m = max((_extent_m(shape) for shape in thing.shapes), default=0.0)
    gyration_m = math.sqrt(c / thing.mass_kg)
    if extent_m and not POINT * extent_m <= gyration_m <= GYRATION * extent_m:
        words = (
            f"{thing.mass_kg:g} kg with {c:.3g} kg m2 is a ring of {2 * gyration_m:.3g} m; it reaches {extent_m:.3g} m"
        )
        yield words, "warning", "the inertia of its data sheet, or none: it is computed from the shapes"


def _extent_m(shape: Any) -> float:
    """The distance of the farthest point of a shape from the origin of its body, at most."""
    return float(np.linalg.norm(shape.frame.xyz)) + float(np.linalg.norm(_half(shape)))


def _half(shape: Any) -> tuple[float, float, float]:
    """Half the sides of the box around a shape."""
    if isinstance(shape, Box):
        x, y, z = shape.size_m
        return 0.5 * x, 0.5 * y, 0.5 * z
    radius = getattr(shape, "radius_m", 0.0)
    along = 0.5 * getattr(shape, "length_m", 0.0) + (radius if isinstance(shape, Capsule) else 0.0)
    return radius, radius, radius if isinstance(shape, Sphere) else along


def _depth_m(shape: Any, point: tuple[float, float, float]) -> float:
    """How far a point in the axes of the body is inside of a shape; 0 or less outside, and of other kinds of shapes."""
    x, y, z = (abs(float(n)) for n in geometry.transform_point(geometry.inverse(shape.frame.pose), point))
    a, b, c = _half(shape)
    if isinstance(shape, Cylinder):
        return min(a - math.hypot(x, y), c - z)
    if isinstance(shape, Sphere):
        return a - math.sqrt(x * x + y * y + z * z)
    return min(a - x, b - y, c - z) if isinstance(shape, Box) else 0.0
