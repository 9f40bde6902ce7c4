"""The values of a URDF by themselves: numbers, axes, sizes, required attributes and names. Pure.

A simulator and a kinematics library read wrong values differently, or leave out the link without a word. So each is an
error before either of them reads the file.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

MOVING = ("revolute", "continuous", "prismatic")
TYPES = (*MOVING, "fixed")
AXIS_SLACK = 1e-4  # of the length of an axis: 0.7071 0.7071 0 is well, 0.707 0.707 0 is half a milliradian off
WHOLE_RAD = math.tau + 0.01  # no attitude in 1,176 published files is beyond it
MANY_TURNS = 4 * math.pi  # limits beyond it are probably in degrees
LONG_M = 20.0  # a greater offset of a joint is probably in millimetres
POSE = {"xyz": 3, "rpy": 3}
INERTIA = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1)
#: path within a link or joint -> its numeric attributes, each with the quantity of its numbers
NUMBERS: dict[str, dict[str, int]] = {
    "inertial/origin": POSE,
    "inertial/mass": {"value": 1},
    "inertial/inertia": INERTIA,
    "collision/origin": POSE,
    "visual/origin": POSE,
    "origin": POSE,
    "axis": {"xyz": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
}
NEEDED: dict[str, tuple[str, ...]] = {"inertial/mass": ("value",), "inertial/inertia": tuple(INERTIA)}
#: shape -> its sizes, which are above 0
SIZES: dict[str, dict[str, int]] = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
}
QUANTITIES = {1: "a finite number", 3: "three finite numbers", 4: "four finite numbers"}


Row = tuple[str, str]  # problem, expected


class UrdfFault(NamedTuple):
    where: str  # link NAME, joint NAME, or robot
    problem: str
    expected: str


def faults(robot: Element) -> Iterator[UrdfFault]:
    """All wrong values of a <robot>, in the order of the file."""
    if not robot.get("name"):
        yield UrdfFault("robot", "it has no name", '<robot name="...">')
    yield from (UrdfFault("robot", problem, expected) for problem, expected in _of_materials(robot))
    for kind in ("link", "joint"):
        parts = robot.findall(kind)
        for name, count in Counter(part.get("name") for part in parts).items():
            if not name:
                yield UrdfFault("robot", f"a <{kind}> has no name", f'<{kind} name="...">')
            elif count > 1:
                yield UrdfFault(f"{kind} {name}", f"{count} of them have this name", "a name of its own for each")
        for part in parts:
            yield from (UrdfFault(f"{kind} {part.get('name')}", *row) for row in _given_twice(part))
            own = _of_link(part) if kind == "link" else _of_joint(part, robot)
            for problem, expected in (*_of_numbers(part), *own):
                yield UrdfFault(f"{kind} {part.get('name')}", problem, expected)


#: path within a link or joint -> elements of which it has one; readers of a URDF take different ones of two
ONCE: dict[str, tuple[str, ...]] = {
    ".": ("inertial", "parent", "child", "origin", "axis", "limit", "mimic", "dynamics", "safety_controller"),
    "inertial": ("origin", "mass", "inertia"),
    "collision": ("origin", "geometry"),
    "visual": ("origin", "geometry"),
}


def _given_twice(part: Element) -> Iterator[Row]:
    for path, tags in ONCE.items():
        for element in part.findall(path):
            for tag in tags:
                if (count := len(element.findall(tag))) > 1:
                    yield f"it has {count} <{tag}>", "one"


def too_long(robot: Element) -> UrdfFault | None:
    """The greatest length, if it is not plausible in metres. Lengths that are not numbers are left out."""
    where, longest = max(_lengths(robot), key=lambda row: row[1], default=("", 0.0))
    if longest <= LONG_M:
        return None
    return UrdfFault(where, f"it states a length of {longest:g} m: is it in millimetres?", "metres")


def soft_limits(joint: Element, soft: Element) -> tuple[float, float] | None:
    """The limits of a <safety_controller> within those of its joint; None: they are not narrower, or not stated."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return None
    hard = [(_values(limit, key) or [0.0])[0] for key in ("lower", "upper")]
    stated = [_values(soft, key) for key in ("soft_lower_limit", "soft_upper_limit")]
    if not all(stated):
        return None
    low, high = (one[0] for one in stated if one)
    low, high = max(low, hard[0]), min(high, hard[1])
    return (low, high) if low < high and (low > hard[0] or high < hard[1]) else None


def _of_numbers(part: Element) -> Iterator[Row]:
    for path, fields in NUMBERS.items():
        for element in part.findall(path):
            yield from _wrong(element, fields, NEEDED.get(path, ()))
            yield from _of_attitude(element)


def _of_attitude(element: Element) -> Iterator[Row]:
    for key in ("quat_xyzw", "quat_wxyz"):
        if element.get(key) is not None:
            yield f'<{element.tag} {key}="{element.get(key)}"> is left out by readers of a URDF', "rpy, in rad"
    if max(map(abs, _values(element, "rpy") or [0.0])) > WHOLE_RAD:
        yield f'<{element.tag} rpy="{element.get("rpy")}"> is more than one turn: is it in degrees?', "rpy, in rad"


def _of_link(link: Element) -> Iterator[Row]:
    for inertial in link.findall("inertial"):
        for tag in ("mass", "inertia"):
            if inertial.find(tag) is None:
                yield f"its <inertial> has no <{tag}>", "mass and inertia"
        for mass in inertial.findall("mass"):
            if (values := _values(mass, "value")) and values[0] < 0.0:
                yield f"its mass is {values[0]:g} kg", "a mass above 0"
    for kind in ("collision", "visual"):
        for part in link.findall(kind):
            yield from _of_shape(kind, part.find("geometry/*"))
            yield from _of_materials(part)


def _of_materials(part: Element) -> Iterator[Row]:
    for material in part.findall("material"):
        if not material.get("name"):
            yield "a <material> has no name", '<material name="..."/>'
        for colour in material.findall("color"):
            yield from _wrong(colour, {"rgba": 4}, ("rgba",))


def _of_shape(kind: str, shape: Element | None) -> Iterator[Row]:
    if shape is None or shape.tag not in SIZES:
        found = "no shape" if shape is None else f"the shape <{shape.tag}>"
        yield f"its <{kind}> has {found}", "<geometry> with one of " + ", ".join(f"<{tag}>" for tag in SIZES)
        return
    if shape.tag == "mesh" and not shape.get("filename"):
        yield f"the <mesh> of its <{kind}> has no filename", '<mesh filename="..."/>'
    sizes = SIZES[shape.tag]
    wrong = list(_wrong(shape, sizes, () if shape.tag == "mesh" else tuple(sizes)))
    yield from wrong
    for field in [] if wrong else sizes:
        values = _values(shape, field) or []
        mirrored = [abs(value) for value in values] if shape.tag == "mesh" else values
        if not all(value > 0.0 for value in mirrored):
            yield f'<{shape.tag} {field}="{shape.get(field)}">', "above 0"


def _of_joint(joint: Element, robot: Element) -> Iterator[Row]:
    kind = joint.get("type")
    if kind not in TYPES:
        yield f"its type is {kind or 'missing'}", f"one of {', '.join(TYPES)}"
    for axis in joint.findall("axis"):
        values = _values(axis, "xyz")
        if kind not in MOVING or values is None or len(values) != 3:
            continue
        length = math.hypot(*values)
        if not length > 1e-9:
            yield f'<axis xyz="{axis.get("xyz")}"> has no direction', "a unit vector, such as 0 0 1"
        elif abs(length - 1.0) > AXIS_SLACK:
            unit = " ".join(f"{value / length:.6g}" for value in values)
            yield f'<axis xyz="{axis.get("xyz")}"> has the length {length:.6g}', f'of unit length: <axis xyz="{unit}"/>'
    for element in joint.findall("dynamics"):
        for key in ("damping", "friction"):
            if (_values(element, key) or [0.0])[0] < 0.0:
                yield f'<dynamics {key}="{element.get(key)}">', "not below 0"
    limit, mimic = joint.find("limit"), joint.find("mimic")
    if limit is not None and kind in ("revolute", "prismatic"):
        lower, upper = ((_values(limit, key) or [0.0])[0] for key in ("lower", "upper"))
        if lower > upper:
            yield f"its limits are {lower:g} and {upper:g}", "lower below upper, in rad or m"
    if mimic is not None and mimic.get("joint") not in [other.get("name") for other in robot.findall("joint")]:
        yield f"it mimics {mimic.get('joint') or 'nothing'}", "the name of another joint"


def _wrong(element: Element, fields: dict[str, int], needed: tuple[str, ...]) -> Iterator[Row]:
    for field, count in fields.items():
        text = element.get(field)
        if text is None and field in needed:
            yield f"<{element.tag}> has no {field}", QUANTITIES[count]
        if text is not None and len(parsed(text) or []) != count:
            yield f'<{element.tag} {field}="{text}">', QUANTITIES[count]


def _values(element: Element, field: str) -> list[float] | None:
    text = element.get(field)
    return None if text is None else parsed(text)


def parsed(text: str) -> list[float] | None:
    """The finite numbers of an attribute; None: something in it is not one."""
    if "_" in text or not text.isascii():  # which Python reads, and other readers of a URDF do not
        return None
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    return values if all(math.isfinite(value) for value in values) else None


def _lengths(robot: Element) -> Iterator[tuple[str, float]]:
    """(place, m) of the offsets of joints, and of the ways of those that slide."""
    for joint in robot.findall("joint"):
        where = f"joint {joint.get('name')}"
        for place in joint.findall("origin"):
            yield where, math.hypot(*(_values(place, "xyz") or []))
        for limit in joint.findall("limit") if joint.get("type") == "prismatic" else []:
            yield where, max(abs(value) for key in ("lower", "upper") for value in _values(limit, key) or [0.0])
