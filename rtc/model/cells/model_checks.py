"""Checks of the robot models of a cell against the cell: joints, links, fingers, postures, meshes. Pure.

Without them, a wrong model would cause a runaway arm or a traceback far from the cause.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rtc.model.cells import urdf_values
from rtc.model.cells.parts import Arm
from rtc.model.cells.urdf import Urdf
from rtc.model.cells.urdf_values import MOVING
from rtc.protocol.spelling import unknown

HULL = ".obj"
WIDTH_SLACK_M = 0.0005

Problems = Iterator[tuple[str, str]]  # place in the cell, problem


def problems(arms: Sequence[Arm], texts: Mapping[str, str]) -> Problems:
    """All problems, arm by arm. `texts`: URDF and SRDF by file name. A list of another length is left to the cell."""
    for n, arm in enumerate(arms):
        wrong = list(_model(f"arms[{n}]", arm, texts))
        yield from wrong
        for m, hand in enumerate(arm.hands if not wrong else ()):
            place, fitted = f"arms[{n}].hands[{m}]", arm.with_hand(hand.name)
            yield from list(_model(place, fitted, texts)) or _other_arm(place, arm, fitted, texts)


def _model(place: str, arm: Arm, texts: Mapping[str, str]) -> Problems:
    try:
        root = ElementTree.fromstring(texts[arm.urdf])
        ElementTree.fromstring(texts[arm.srdf])
    except ElementTree.ParseError as error:
        yield f"{place}.urdf", f"the model of {arm.name} is not XML: {error}"
        return
    wrong = [f"{where}: {problem}; expected: {expected}" for where, problem, expected in urdf_values.faults(root)]
    for field, problem in [("urdf", one) for one in wrong] or _arm(arm, Urdf(root), texts):
        yield f"{place}.{field}", f"{arm.urdf}: {problem}"


def _other_arm(place: str, arm: Arm, fitted: Arm, texts: Mapping[str, str]) -> Problems:
    """That the arm with a hand is not the arm without one: its joints lie elsewhere, or have other limits."""
    bare, own = (ElementTree.fromstring(texts[one.urdf]) for one in (arm, fitted))
    for joint in arm.joints:
        same = [
            [(part.tag, sorted(part.attrib.items())) for part in robot.findall(f"joint[@name='{joint}']/*")]
            for robot in (bare, own)
        ]
        if same[0] != same[1]:
            yield f"{place}.urdf", f"{fitted.urdf}: {joint} differs from that of {arm.urdf}: a hand changes no joint"


def hulls(urdf: str) -> list[str]:
    """The hull files that a URDF names in its collision shapes, relative to its own folder."""
    try:
        root = ElementTree.fromstring(urdf)
    except ElementTree.ParseError:
        return []
    return [mesh for mesh in _meshes(root) if mesh.endswith(HULL) and not mesh.startswith(("/", "package:"))]


def _meshes(robot: ElementTree.Element) -> list[str]:
    return sorted({str(mesh.get("filename")) for mesh in robot.findall("link/collision//mesh")})


def _arm(arm: Arm, model: Urdf, texts: Mapping[str, str]) -> Problems:
    fields: dict[str, tuple[Sequence[str], Mapping[str, object], str]] = {
        "joints": (arm.joints, model.joints, "joint"),
        "tcp_link": ([arm.tcp_link], model.links, "link"),
        "sensor_joint": ([arm.sensor_joint] if arm.sensor_joint is not None else [], model.joints, "joint"),
        "gripper.finger_joints": (arm.gripper.finger_joints, model.joints, "joint"),
        "gripper.finger_links": (arm.gripper.finger_links, model.links, "link"),
        "gripper.palm_link": ([arm.gripper.palm_link], model.links, "link"),
    }
    missing = [
        (field, unknown(what, name, known))
        for field, (names, known, what) in fields.items()
        for name in names
        if name not in known
    ]
    if missing:
        yield from missing
        return
    for name in sorted(model.links.keys() & model.joints.keys()):
        yield "urdf", f"a link and a joint have the name {name}: rename the joint, here and in the cell"
    yield from _chain(arm, model)
    yield from _postures(arm, model)
    yield from _fingers(arm, model)
    for mesh in _meshes(model.robot):
        if mesh not in texts and not (mesh.startswith("/") and Path(mesh).is_file()):
            yield "urdf", f"mesh {mesh} is not found: `rtc cell new` makes hulls of meshes; or use boxes and cylinders"


def _chain(arm: Arm, model: Urdf) -> Problems:
    moving = model.moving_way(arm.tcp_link)
    endless = [joint for joint in moving if model.type(joint) == "continuous"]
    if endless:
        yield "joints", f"{', '.join(endless)} is continuous: make it revolute with limits, such as -6.28 and 6.28"
    if moving != arm.joints:
        yield (
            "joints",
            f"the joints that move {arm.tcp_link} are {', '.join(moving)}; named are {', '.join(arm.joints)}",
        )
    for joint in (one for one in arm.joints if model.joints[one].find("mimic") is not None):
        yield "joints", f"{joint} mimics another joint, which no motor of an arm does: remove its <mimic>"
    others = [joint for joint in model.joints if model.type(joint) in MOVING and joint not in arm.joints]
    loose = [joint for joint in others if joint not in arm.gripper.finger_joints]
    if loose:
        yield "gripper.finger_joints", f"{', '.join(loose)} can move, but is neither a joint of the arm nor of a finger"
    if arm.sensor_joint is None:
        return
    if model.type(arm.sensor_joint) != "fixed":
        yield "sensor_joint", f"{arm.sensor_joint} is {model.type(arm.sensor_joint)}; the sensor needs a fixed joint"
    elif arm.sensor_joint not in model.way_to(arm.gripper.palm_link):
        yield (
            "sensor_joint",
            f"{arm.sensor_joint} does not carry {arm.gripper.palm_link}: the sensor would measure nothing",
        )


def _postures(arm: Arm, model: Urdf) -> Problems:
    postures = {"home_deg": (arm.home_deg, arm.home_rad), "stow_deg": (arm.stow_deg, arm.stow_rad)}
    for field, (given, values) in postures.items():
        for joint, written, value in zip(arm.joints, given, values, strict=False):
            slides, limits = model.type(joint) == "prismatic", model.limits(joint)
            if slides != isinstance(written, str):
                yield field, f"{joint} {'slides: write metres, such as 0.5 m' if slides else 'turns: write degrees'}"
            elif model.joints[joint].find("limit") is not None and not limits[0] <= value <= limits[1]:
                at = written if slides else f"{written:g} deg"
                yield field, f"{joint} is at {at} there; its limits are {_range(limits, slides)}"
    for joint, rate in zip(arm.joints, arm.acceleration_deg_s2, strict=False):
        if (model.type(joint) == "prismatic") != isinstance(rate, str):
            yield "acceleration_deg_s2", f"{joint}: write a number in deg/s2, or for a joint that slides such as 1 m/s2"


def _range(limits: tuple[float, float], slides: bool) -> str:
    low, high = limits
    return f"{low:g} and {high:g} m" if slides else f"{math.degrees(low):.1f} and {math.degrees(high):.1f} deg"


def _fingers(arm: Arm, model: Urdf) -> Problems:
    half_m = 0.5 * arm.gripper.max_opening_m
    for joint, link in zip(arm.gripper.finger_joints, arm.gripper.finger_links, strict=True):
        place = "gripper.finger_joints"
        if model.type(joint) != "prismatic":
            yield place, f"{joint} is {model.type(joint)}; a finger needs a prismatic joint"
            return
        if model.joints[joint].find("mimic") is not None:
            yield place, f"{joint} mimics another joint; each finger needs its own motor"
        if model.child[joint] != link:
            yield "gripper.finger_links", f"{joint} carries {model.child[joint]}, not {link}"
        low, high = model.limits(joint)
        if low < -WIDTH_SLACK_M or high < half_m - WIDTH_SLACK_M:
            yield (
                "gripper.max_opening_m",
                f"{joint} goes from {low:g} to {high:g} m; a finger opens from 0 to {half_m:g} m, half of the opening",
            )
    a, b = arm.gripper.finger_joints
    if a == b:
        yield "gripper.finger_joints", f"{a} is named twice"
    elif model.parent[a] == model.parent[b] and not model.opposed(a, b):
        yield "gripper.finger_joints", f"{a} and {b} do not move in opposite directions"
