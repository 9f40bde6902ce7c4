"""A user's URDF made fit for a cell: hulls for meshes, a hand, a frame `tcp`, motors for both fingers.

Each change is a note for the user. Links and joints keep their names.
"""

from __future__ import annotations

import copy
import itertools
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from rtc.apps.authoring import inertias
from rtc.apps.authoring.hull import hull_of
from rtc.apps.authoring.robot_file import PACKAGE, RobotFile, implausible, kinematics
from rtc.model.cells import urdf_values
from rtc.model.cells.urdf import number, numbers, origin
from rtc.model.cells.urdf_values import MOVING
from rtc.model.robot.numeric_ik import MIN_JOINTS
from rtc.protocol.outcomes import ProgramError
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

HAND = Path(__file__).with_name("hand.urdf")
ASIDE_M = 0.02  # by which a link extends to one side of the axis of its joint, if it points there
STRAIGHT = 0.98  # cosine of the angle to an axis of the link that is taken for that axis
CLEAR_M = 0.01  # between the middles of two bodies, to tell which is farther out
BELOW_TIP_M = 0.015  # distance of the tcp below the finger tips, at most a quarter of a finger
TCP, MOUNT = "tcp", "wrist_ft"
DEFAULT_EFFORT, DEFAULT_SPEED = 50.0, 1.0  # of a joint without a motor in the URDF, at least
OVER_WEIGHT, SEED, POSTURES = 2.5, 1, 200  # of its motor, over the greatest weight on it in these postures
QUICK = 2.0  # rad/s^2, m/s^2: which its motor gives the whole arm beside that weight
#: whole words in the name of a fixed joint that is a wrist sensor
SENSOR_WORDS = {"force", "torque", "ft", "fts", "wrench", "forcetorque", "ftsensor"}
#: whole words in the name of a joint that opens a hand
HAND_WORDS = {"gripper", "jaw", "jaws", "finger", "fingers", "thumb", "knuckle", "claw", "grip", "clamp", "pinch"}
# The last joint of published arms on a table turns by 3.1 rad or more, a jaw by 0.5 to 2.2 rad. Wrists of humanoids
# turn by 0.9 to 3.2 rad, among the jaws: they are refused, and the message names them for --tip. Fingers of published
# hands slide by 0.06 m or less. No published arm here ends in a slide; that of the portal in the tests has 0.4 m.
JAW_RAD, FINGER_M = 2.6, 0.15
FINGER_JOINTS = 4  # at most of one finger, beyond the palm
ARM_JOINTS = 4  # a chain that branches beyond as many has fingers there
DATA_PACKAGE = "pybullet_data"  # its visual meshes are named by package, so that a cell does not name a folder


@dataclass
class AdaptedArm:
    """The changed model and what a cell says about it. `fingers`: joints, in the order +y, -y of the tcp."""

    robot: RobotFile
    joints: list[str]
    palm: str
    fingers: tuple[str, str]
    sensor: str | None = None
    hulls: dict[str, str] = field(default_factory=dict)  # file -> text
    without_effort: list[str] = field(default_factory=list)  # joints to which the URDF gives none
    notes: list[str] = field(default_factory=list)

    @property
    def urdf(self) -> str:
        ElementTree.indent(self.robot.robot)
        return '<?xml version="1.0"?>\n' + ElementTree.tostring(self.robot.robot, encoding="unicode") + "\n"

    @property
    def finger_links(self) -> tuple[str, str]:
        a, b = self.fingers
        return self.robot.child[a], self.robot.child[b]


def adapt(path: Path, folder: str, tip: str = "") -> AdaptedArm:
    """The model of a URDF file for a cell. `folder`: of the hulls; `tip`: the link that gets a new hand.

    Raises ProgramError for a model that cannot be used, with the reason.
    """
    robot = RobotFile(path)
    notes: list[str] = []
    if tip:
        _cut(robot, tip, notes)  # with the faults of what is beyond
    normalise(robot, notes)
    _refuse_wrong_values(robot)
    _separate_names(robot, notes)
    fingers = None if tip else _fingers(robot, notes)
    if fingers is None:
        end = tip or _end_of_arm(robot, notes)
        if not tip:
            _cut(robot, end, notes)
        _mount_hand(robot, end, notes)
        fingers = ("finger_a_slide", "finger_b_slide")
    palm = robot.parent[fingers[0]]
    arm = AdaptedArm(robot, robot.moving_way(palm), palm, fingers, notes=notes)
    if len(arm.joints) < MIN_JOINTS:
        moving = f"only {arm.joints[0]} moves" if arm.joints else "no joint moves"
        raise ProgramError(
            f"{path}: {moving} {palm}; expected: an arm with {MIN_JOINTS} joints or more before its hand"
        )
    _tidy(arm)
    _meshes(arm, folder)
    _assume_inertias(arm)
    _tool(arm)
    _assume_efforts(arm)
    arm.sensor = _sensor(arm)
    return arm


def _assume_efforts(arm: AdaptedArm) -> None:
    """Motors that carry the arm, for the joints to which the URDF gives no effort: a large arm needs large ones."""
    if not arm.without_effort:
        return
    model = kinematics(arm.urdf, arm.robot.path)
    model.gravity.linear[:] = (0.0, 0.0, -9.81)
    data, still = model.createData(), np.zeros(model.nv)
    postures = np.random.default_rng(SEED).uniform(
        model.lowerPositionLimit, model.upperPositionLimit, (POSTURES, model.nq)
    )
    weights = np.abs([pin.rnea(model, data, q, still, still) for q in postures]).max(axis=0)
    inertias = np.max([np.diag(np.asarray(pin.crba(model, data, q))) for q in postures], axis=0)
    for name in arm.without_effort:
        at = model.joints[model.getJointId(name)].idx_v
        effort = max(DEFAULT_EFFORT, math.ceil(max(OVER_WEIGHT * weights[at], weights[at] + QUICK * inertias[at])))
        limit = arm.robot.joints[name].find("limit")
        assert limit is not None
        limit.set("effort", f"{effort:g}")
        arm.notes.append(f"{name} has no effort: {effort:g} is assumed; see its data sheet")


def _refuse_wrong_values(robot: RobotFile) -> None:
    long = urdf_values.too_long(robot.robot)
    wrong = [*urdf_values.faults(robot.robot), *([] if long is None else [long])]
    if wrong:
        where, problem, expected = wrong[0]
        others = f". All {len(wrong)} faults: rtc cell check {robot.path}" if wrong[1:] else ""
        raise ProgramError(f"{robot.path}: {where}: {problem}; expected: {expected}{others}")


def normalise(robot: RobotFile, notes: list[str]) -> None:
    """Give each axis unit length: the direction is what a URDF means, and a simulator would take the length, too. Give
    each material a name, without which a reader leaves out its link."""
    for n, material in enumerate(robot.robot.iterfind("link/*/material")):
        if not material.get("name"):
            material.set("name", f"material_{n}")
    for name, joint in robot.joints.items():
        axis = joint.find("axis")
        values = None if axis is None else urdf_values.parsed(axis.get("xyz", ""))
        if axis is None or robot.type(name) not in MOVING or values is None or len(values) != 3:
            continue
        length = math.hypot(*values)
        if not length > 1e-9 or length == 1.0:
            continue
        unit = " ".join(f"{value / length:.12g}" for value in values)
        if abs(length - 1.0) > urdf_values.AXIS_SLACK:
            notes.append(f"the axis of {name} has the length {length:.4g}: it is {unit} here")
        axis.set("xyz", unit)


def _separate_names(robot: RobotFile, notes: list[str]) -> None:
    """Rename joints that have the name of a link: pinocchio cannot tell their frames apart."""
    for name in [name for name in robot.joints if name in robot.links]:
        other = f"{name}_joint"
        while other in robot.joints or other in robot.links:
            other += "_"
        robot.joints[name].set("name", other)
        for mimic in robot.robot.iterfind(f"joint/mimic[@joint='{name}']"):
            mimic.set("joint", other)
        robot.index()
        notes.append(f"the joint {name} has the name of a link: it is {other} here")


# --- the hand ------------------------------------------------------------------------------------------


def _fingers(robot: RobotFile, notes: list[str]) -> tuple[str, str] | None:
    """The two sliding joints of a parallel hand, or None. Other moving parts of a hand are refused."""
    slides = [j for j in robot.joints if robot.type(j) == "prismatic" and not _moves(robot, robot.child[j])]
    pairs = [
        (a, b)
        for a, b in itertools.combinations(slides, 2)
        if robot.parent[a] == robot.parent[b] and robot.moving_way(robot.parent[a]) and _opposed(robot, a, b, notes)
    ]
    if pairs:
        palms = list(dict.fromkeys(robot.parent[a] for a, _ in pairs))
        if palms[1:]:
            notes.append(f"it has the hands {', '.join(palms)}: the arm of {palms[0]} is taken; see --tip")
        return pairs[0]
    loose = [j for j in robot.joints if robot.type(j) in MOVING and robot.joints[j].find("mimic") is not None]
    if loose:
        raise _not_a_hand(robot, f"{_few(loose)} mimic other joints, which no motor of an arm does", loose[0])
    return None


def _opposed(robot: RobotFile, a: str, b: str, notes: list[str]) -> bool:
    """Whether two sliding joints open a hand. One that opens with negative values is turned round."""
    turned = [joint for joint in (a, b) if robot.limits(joint)[1] <= 0.0 and robot.limits(joint)[0] < 0.0]
    directions = [
        (-1.0 if joint in turned else 1.0) * (robot.placement(joint)[:3, :3] @ robot.axis(joint)) for joint in (a, b)
    ]
    if float(np.linalg.norm(directions[0] + directions[1])) >= 1e-3:
        return False
    for name in turned:
        joint, (low, high) = robot.joints[name], robot.limits(name)
        axis, limit = joint.find("axis"), joint.find("limit")
        assert limit is not None
        axis = ElementTree.SubElement(joint, "axis") if axis is None else axis
        axis.set("xyz", " ".join(f"{0.0 - value:.12g}" for value in robot.axis(name)))
        limit.set("lower", f"{-high + 0.0:.12g}")
        limit.set("upper", f"{-low:.12g}")
        notes.append(f"{name} opens with negative values: its axis is turned round")
    return True


def _end_of_arm(robot: RobotFile, notes: list[str]) -> str:
    """The last link of the longest chain of moving joints: the farthest fixed frame beyond its last joint is not.

    Raises ProgramError if it ends in what may be a hand, or if several chains are as long.
    """
    chains = _chains(robot)
    if not chains:
        raise ProgramError(f"{robot.path}: it has no joint that moves")
    chain, last = chains[0], chains[0][-1]
    if len(chain) < MIN_JOINTS:
        return robot.child[last]
    ends = [_before_hand(robot, one[-1]) for one in chains if len(one) == len(chain)]
    if len(set(ends)) > 1:
        raise ProgramError(
            f"{robot.path}: it has {len(set(ends))} chains of joints that are as long. Name the last link of the arm "
            f"with --tip: {_few(list(dict.fromkeys(ends)))}"
        )
    if ends[0] != robot.child[last]:
        first = next(joint for joint in chain if robot.parent[joint] == ends[0])
        raise _not_a_hand(robot, f"{_few(_beyond(robot, ends[0]))} may be a hand", first)
    low, high = robot.limits(last)
    slides = robot.type(last) == "prismatic"
    if len(chain) > MIN_JOINTS and 0.0 < high - low < (FINGER_M if slides else JAW_RAD):
        way = f"slides by {1e3 * (high - low):.0f} mm" if slides else f"turns by {math.degrees(high - low):.0f} deg"
        why = f"its last joint {last} {way} only, as a jaw does and no wrist"
        raise _not_a_hand(robot, why, last, f", or --tip {robot.child[last]} if it belongs to the arm")
    others = [robot.child[one[-1]] for one in chains[1:]]
    if others:
        notes.append(f"the longest chain is taken for the arm, to {robot.child[last]}; others end at {_few(others)}")
    notes.append("it has no hand with two sliding fingers: a parallel hand with a wrist sensor is mounted")
    return robot.child[last]


def _chains(robot: RobotFile) -> list[list[str]]:
    """The moving joints from the base to each end, the longest chain first."""
    ends = [j for j in robot.joints if robot.type(j) in MOVING and not _moves(robot, robot.child[j])]
    return sorted((robot.moving_way(robot.child[joint]) for joint in ends), key=len, reverse=True)


def _beyond(robot: RobotFile, link: str) -> list[str]:
    """The moving joints that a link carries."""
    below = set(robot.below(link))
    return [joint for joint in robot.joints if robot.parent[joint] in below and robot.type(joint) in MOVING]


def _before_hand(robot: RobotFile, joint: str) -> str:
    """The link before the first joint on the way to `joint` that may open a hand; else the link of `joint`.

    A hand has several fingers; or its name says it; or one of its joints mimics another. Several chains are fingers
    if an arm is before them, or if they have few joints. A word of all joints is the name of the robot.
    """
    way, chains = robot.moving_way(robot.child[joint]), _chains(robot)
    of_all = set.intersection(*(set(words(one)) for chain in chains for one in chain))
    for place, one in enumerate(way):
        beyond = [chain[place:] for chain in chains if chain[:place] == way[:place] and chain[place:]]
        branches = len({chain[0] for chain in beyond}) > 1
        several = branches and (place >= ARM_JOINTS or (place > 0 and max(map(len, beyond)) <= FINGER_JOINTS))
        named = HAND_WORDS & (set(words(one)) - of_all)
        if several or named or robot.joints[one].find("mimic") is not None:
            return robot.parent[one]
    return robot.child[joint]


def _not_a_hand(robot: RobotFile, why: str, joint: str, otherwise: str = "") -> ProgramError:
    """The refusal of a hand that is not understood. `joint`: of it; `otherwise`: what else the user may name."""
    tip = _before_hand(robot, joint)
    tip = robot.parent[joint] if tip == robot.child[joint] else tip
    such = f", such as --tip {tip}{otherwise}" if robot.moving_way(tip) else ""
    return ProgramError(
        f"{robot.path}: {why}; a hand needs two sliding fingers that open in opposite directions. Name the last link "
        f"of the arm with --tip{such}: all beyond it is removed, and a parallel hand is mounted there"
    )


def words(name: str) -> list[str]:
    """The words of a name, in small letters: they end at _ - . digits, and before a capital letter."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return [part.lower() for part in parts]


def _few(names: Sequence[str]) -> str:
    more = len(names) - 3
    return ", ".join(names[:3]) + (f" and {more} other{'s' if more > 1 else ''}" if more > 0 else "")


def _moves(robot: RobotFile, link: str) -> bool:
    """Whether a link carries a joint that moves."""
    below = set(robot.below(link))
    return any(robot.type(joint) in MOVING for joint, parent in robot.parent.items() if parent in below)


def _cut(robot: RobotFile, tip: str, notes: list[str]) -> None:
    """Remove everything beyond the tip, and every moving branch that is not on the way to it."""
    if tip not in robot.links:
        raise ProgramError(f"{robot.path}: {unknown('link', tip, robot.links)}")
    way = set(robot.way_to(tip))
    gone: list[str] = []
    for joint in list(robot.joints):
        beyond = robot.parent[joint] == tip
        branch = joint not in way and robot.parent[joint] != tip and (robot.type(joint) in MOVING)
        if beyond or branch:
            gone += robot.below(robot.child[joint])
    for link in dict.fromkeys(gone):
        robot.robot.remove(robot.links[link])
        robot.robot.remove(robot.joints[robot.carrier[link]])
    robot.index()
    if gone:
        notes.append(f"removed beyond {tip}: {', '.join(dict.fromkeys(gone))}")


def _mount_hand(robot: RobotFile, tip: str, notes: list[str]) -> None:
    """Adds the parallel hand on the last link, where that points."""
    axis = _outwards(robot, tip)
    reach = max([0.0, *(float((points @ axis).max()) for points in _points(robot, tip))])
    mount = ElementTree.SubElement(robot.robot, "joint", name=MOUNT, type="fixed")
    ElementTree.SubElement(mount, "parent", link=tip)
    ElementTree.SubElement(mount, "child", link="sensor")
    roll, pitch, yaw = geometry.to_rpy(geometry.from_matrix(_looking_along(axis, reach * axis))).tolist()
    xyz = " ".join(f"{x:.6g}" for x in reach * axis)
    ElementTree.SubElement(mount, "origin", xyz=xyz, rpy=f"{roll:.9g} {pitch:.9g} {yaw:.9g}")
    hand = ElementTree.fromstring(HAND.read_text(encoding="utf-8"))
    taken = [str(part.get("name")) for part in hand if part.get("name") in {**robot.links, **robot.joints}]
    if taken:
        raise ProgramError(f"{robot.path}: rename {', '.join(taken)}: the hand that is mounted has these names")
    robot.robot.extend(hand)
    notes.append(f"the hand is on {tip}, {1000 * reach:.0f} mm beyond its origin: check the picture")
    robot.index()


def _outwards(robot: RobotFile, tip: str) -> Array:
    """The direction in which the last link points, in its axes: along the axis of the last joint, away from the body
    before it; or square to it, if the last joint bends a link that is long that way."""
    last = robot.moving_way(tip)[-1]
    at = robot.pose_in(tip, robot.child[last])
    axis, joint = at[:3, :3].T @ robot.axis(last), -at[:3, :3].T @ at[:3, 3]
    clouds = _points(robot, tip)
    own = np.vstack(clouds).mean(axis=0) if clouds else None
    if own is not None:
        aside = own - joint - axis * float((own - joint) @ axis)
        if float(np.linalg.norm(aside)) > max(ASIDE_M, 2.0 * abs(float((own - joint) @ axis))):
            bent: Array = aside / np.linalg.norm(aside)
            straight: Array = np.round(bent)
            return straight if np.abs(bent).max() > STRAIGHT else bent
    beyond = 0.0
    for link in (robot.parent[one] for one in reversed(robot.way_to(tip))):
        if before := _points(robot, link):
            pose = np.linalg.inv(robot.pose_in(tip, link))
            middle = pose[:3, :3] @ np.vstack(before).mean(axis=0) + pose[:3, 3]
            beyond = float(((own if own is not None else np.zeros(3)) - middle) @ axis)
            if abs(beyond) > CLEAR_M:
                break
    outwards: Array = axis if beyond >= 0.0 else -axis
    return outwards


def _looking_along(axis: Array, at: Array) -> Array:
    """A frame whose z is `axis`, as near to the axes of the link as it gets."""
    aside = np.array((0.0, 1.0, 0.0)) if abs(axis[1]) < 0.9 else np.array((1.0, 0.0, 0.0))
    x = np.cross(aside, axis)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack((x, np.cross(axis, x), axis), axis=1)
    matrix[:3, 3] = at
    return matrix


# --- links and joints ----------------------------------------------------------------------------------


def _tidy(arm: AdaptedArm) -> None:
    """Limits for endless joints, a motor for each finger, frames without mass, and nothing else that moves."""
    robot, kept = arm.robot, {*arm.joints, *arm.fingers}
    for name, joint in robot.joints.items():
        if robot.type(name) not in MOVING:
            continue
        if name not in kept:
            joint.set("type", "fixed")
            for tag in ("limit", "mimic", "dynamics", "safety_controller", "calibration"):
                for part in joint.findall(tag):
                    joint.remove(part)
            arm.notes.append(f"{name} moves neither the hand nor a finger: it is fixed at 0")
            continue
        if (mimic := joint.find("mimic")) is not None:
            if name in arm.joints:
                raise ProgramError(
                    f"{robot.path}: joint {name} mimics {mimic.get('joint')}: a joint of the arm needs a motor of its "
                    f"own. Remove its <mimic> if it has one, or name a link before it with --tip, such as --tip "
                    f"{robot.parent[name]}"
                )
            joint.remove(mimic)
            arm.notes.append(f"the finger {name} mimics another joint: it gets a motor of its own")
        _soft_limits(arm, name, joint)
        if robot.type(name) == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", f"{-math.tau:.6f}")
            limit.set("upper", f"{math.tau:.6f}")
            arm.notes.append(f"{name} is continuous: it gets one turn either way")
        _motor(arm, name, joint)
    for name, link in robot.links.items():
        inertial = link.find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is not None and (mass is None or number(mass, "value") == 0.0):
            link.remove(inertial)
        elif inertias.made_possible(inertial):
            arm.notes.append(f"no rigid body has the inertia of {name}: its smaller moments are raised")


def _soft_limits(arm: AdaptedArm, name: str, joint: ElementTree.Element) -> None:
    """The limits of a <safety_controller>, which no reader here keeps, instead of the wider ones of <limit>."""
    soft, limit = joint.find("safety_controller"), joint.find("limit")
    if soft is None:
        return
    joint.remove(soft)
    narrow = urdf_values.soft_limits(joint, soft)
    if narrow is None or limit is None:
        return
    for key, value in zip(("lower", "upper"), narrow, strict=True):
        limit.set(key, f"{value:.9g}")
    arm.notes.append(f"the soft limits of {name} are its limits here: {narrow[0]:g} and {narrow[1]:g}")


def _assume_inertias(arm: AdaptedArm) -> None:
    """Masses by size for the moving links to which the URDF gives none: else physics takes another one than planning,
    and a motor moves nothing."""
    for name, link in arm.robot.links.items():
        clouds = outline(arm, name) if name != arm.robot.root else []
        if clouds and inertias.made_plausible(link, np.vstack(clouds)):
            arm.notes.append(f"the inertia of {name} is far too great for its size: that of a box is taken")
    made = []
    for name in (arm.robot.child[joint] for joint in (*arm.joints, *arm.fingers)):
        link = arm.robot.links[name]
        if link.find("inertial") is not None:
            continue
        if clouds := outline(arm, name):
            made.append(f"{name} {inertias.by_size(link, np.vstack(clouds)):.2g} kg")
        else:
            arm.notes.append(f"link {name} has neither mass nor shape: state a mass in the URDF")
    if made:
        arm.notes.append(f"no mass is given for {_few(made)}, by size: see the data sheet")


def _motor(arm: AdaptedArm, name: str, joint: ElementTree.Element) -> None:
    limit = joint.find("limit")
    if limit is None:
        raise ProgramError(f"{arm.robot.path}: joint {name} has no <limit>: state lower, upper, effort and velocity")
    if not number(limit, "velocity") > 0.0:
        limit.set("velocity", f"{DEFAULT_SPEED:g}")
        arm.notes.append(f"{name} has no velocity: {DEFAULT_SPEED:g} is assumed; see its data sheet")
    if not number(limit, "effort") > 0.0:
        limit.set("effort", f"{DEFAULT_EFFORT:g}")
        arm.without_effort.append(name)
    lower, upper = arm.robot.limits(name)
    if joint.get("type") == "revolute" and max(-lower, upper) > urdf_values.MANY_TURNS:
        arm.notes.append(f"the limits of {name} are {lower:g} and {upper:g} rad: are they in degrees?")
    if not lower < upper:
        raise ProgramError(
            f"{arm.robot.path}: joint {name}: its limits are {lower:g} and {upper:g}; "
            "expected: lower below upper, in rad or m"
        )


def _points(robot: RobotFile, link: str) -> list[Array]:
    """Points of the outline of a link, in its axes: hull vertices of meshes, corners of boxes and cylinders."""
    found = []
    for part in robot.links[link].findall("collision") or robot.links[link].findall("visual"):
        shape = part.find("geometry/*")
        if shape is None:
            continue
        if shape.tag == "mesh":
            points = robot.vertices(shape)
        elif shape.tag == "box":
            points = 0.5 * np.array(numbers(shape, "size", (0.0, 0.0, 0.0))) * _CORNERS
        else:
            radius = number(shape, "radius")
            half = 0.5 * number(shape, "length") if shape.tag == "cylinder" else radius
            points = np.array((radius, radius, half)) * _CORNERS
        at = origin(part)
        found.append(points @ at[:3, :3].T + at[:3, 3])
    return found


_CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def _meshes(arm: AdaptedArm, folder: str) -> None:
    """Hulls instead of collision meshes; visual meshes by absolute path or package, without those not found."""
    robot, worst_m = arm.robot, 0.0
    for name, link in robot.links.items():
        if not link.findall("collision"):
            for visual in link.findall("visual"):
                shape = copy.deepcopy(visual)
                shape.tag = "collision"
                for material in shape.findall("material"):
                    shape.remove(material)
                link.append(shape)
        for n, collision in enumerate(link.findall("collision")):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            points = robot.vertices(mesh)
            if wrong := implausible(points, str(mesh.get("filename"))):
                raise ProgramError(f"{robot.path}: link {name}: {wrong}")
            hull = hull_of(points, f"{name}, collision {n}")
            file = f"{folder}/{name}{f'-{n}' if n else ''}.obj"
            arm.hulls[file] = hull.text
            worst_m = max(worst_m, hull.left_out_m)
            mesh.attrib = {"filename": file}
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None:
                found = robot.mesh_file(str(mesh.get("filename")))
                if found is None:
                    link.remove(visual)
                else:
                    mesh.set("filename", _named(found))
    if arm.hulls:
        arm.notes.append(
            f"{len(arm.hulls)} meshes are replaced by convex hulls in {folder}/, which the mesh exceeds by at most "
            f"{1000 * worst_m:.1f} mm"
        )


def _named(file: Path) -> str:
    path = str(file.resolve())
    marker = f"/{DATA_PACKAGE}/"
    return f"{PACKAGE}{DATA_PACKAGE}/{path.partition(marker)[2]}" if marker in path else path


def _tool(arm: AdaptedArm) -> None:
    """The frame tcp between the fingers: z out of the palm, y along the first finger's way to open."""
    robot = arm.robot
    if TCP in robot.links:
        if robot.moving_way(TCP) == arm.joints:
            return
        raise ProgramError(f"{robot.path}: the link {TCP} does not move with {arm.palm}; rename it")
    y = robot.placement(arm.fingers[0])[:3, :3] @ robot.axis(arm.fingers[0])
    points = []
    for joint in arm.fingers:
        at = robot.placement(joint)
        points += [p @ at[:3, :3].T + at[:3, 3] for p in outline(arm, robot.child[joint])]
    cloud = np.vstack(points)
    middle = cloud.mean(axis=0)
    out = middle - y * float(middle @ y)
    if float(np.linalg.norm(out)) < 1e-3:
        raise ProgramError(f"{robot.path}: the fingers are in the origin of {arm.palm}: add a link {TCP} yourself")
    z = np.zeros(3)
    z[int(np.abs(out).argmax())] = np.sign(out[int(np.abs(out).argmax())])
    z -= y * float(z @ y)
    z /= np.linalg.norm(z)
    along = cloud @ z
    tip_m, foot_m = float(along.max()), float(along.min())
    height = tip_m - min(BELOW_TIP_M, 0.25 * (tip_m - foot_m))
    sideways = np.cross(y, z)
    centre = 0.5 * float((cloud @ sideways).max() + (cloud @ sideways).min())
    frame = np.eye(4)
    frame[:3, :3] = np.stack((sideways, y, z), axis=1)
    frame[:3, 3] = height * z + centre * sideways
    mount = ElementTree.SubElement(robot.robot, "joint", name=f"{TCP}_mount", type="fixed")
    ElementTree.SubElement(mount, "parent", link=arm.palm)
    ElementTree.SubElement(mount, "child", link=TCP)
    rpy = geometry.to_rpy(geometry.from_matrix(frame)).tolist()
    ElementTree.SubElement(
        mount,
        "origin",
        xyz=" ".join(f"{round(x, 5) + 0.0:g}" for x in frame[:3, 3]),
        rpy=" ".join(f"{round(x, 9) + 0.0:g}" for x in rpy),
    )
    ElementTree.SubElement(robot.robot, "link", name=TCP)
    robot.index()
    arm.notes.append(f"the frame {TCP} is {1000 * height:.0f} mm from {arm.palm}, between the fingers")


def outline(arm: AdaptedArm, link: str) -> list[Array]:
    """Points of the outline of a link, in its axes, after the meshes were replaced by hulls."""
    found = []
    for part in arm.robot.links[link].findall("collision"):
        mesh = part.find("geometry/mesh")
        text = "" if mesh is None else arm.hulls.get(str(mesh.get("filename")), "")
        if text:
            rows = [line.split()[1:] for line in text.splitlines() if line.startswith("v ")]
            at = origin(part)
            found.append(np.array(rows, dtype=float) @ at[:3, :3].T + at[:3, 3])
    return found or _points(arm.robot, link)


def _sensor(arm: AdaptedArm) -> str | None:
    """A fixed joint between the last moving joint and the palm that is a sensor by its name; None: joint torques
    measure contact."""
    way = arm.robot.way_to(arm.palm)
    beyond = way[way.index(arm.joints[-1]) + 1 :]
    found = next((joint for joint in beyond if SENSOR_WORDS & set(words(joint))), None)
    if found is None:
        arm.notes.append("it has no wrist sensor: contact is measured by joint torques (sensor_joint: null)")
    elif found != MOUNT:
        arm.notes.append(f"the fixed joint {found} is taken for the wrist sensor, by its name")
    return found
