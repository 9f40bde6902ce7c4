"""The first cell of an arm: what its URDF does not state is sampled or computed. Deterministic.

The arm stands on a floor under gravity, before two pads and a cube, so that MOVE, GRASP and PLACE work at once.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pinocchio as pin

from rtc.apps.authoring import self_collisions
from rtc.apps.authoring.adapt import ARM_JOINTS, TCP, AdaptedArm, adapt, outline
from rtc.apps.authoring.review import of_urdf
from rtc.apps.authoring.robot_file import RobotFile
from rtc.apps.authoring.words_and_keys import misnamed
from rtc.model.cells import two_readers
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Arm, Box, Frame, GraspPoint, Gripper, Object, Place, Seat, Vec3
from rtc.model.cells.urdf import number
from rtc.model.robot import hulls
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.model.robot.numeric_ik import WHOLE
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

SEED, POSTURES = 1, 1500  # among which home and stow are chosen
EFFORT = 0.6  # share of the motor torque that a posture may need against gravity
FAR = 0.9  # half turns of a joint from home to stow, at most if the arm allows it
NEAR_HOME = 0.06  # weight of half a turn of a joint from home, against a reach more of extent, for stow
ACCELERATION = 0.4  # share of the remaining motor torque that accelerates the joint alone
ACCELERATIONS = (0.5, 10.0)  # rad/s^2, m/s^2: range of what is proposed
PAYLOADS_KG = (0.5, 10.0)
GRAVITY = (0.0, 0.0, -9.81)
GRIP_N, SPEED_M_S = 60.0, 0.05  # of a hand whose URDF states none
CUBE_M, CUBE_KG, PAD_M, PAD_HEIGHT_M = 0.04, 0.5, 0.12, 0.05
ABOVE_MIDDLE_M = 0.008  # of the cube is its grasp point, so that the finger tips do not touch the pad
MAGNET_N = 10.0  # of a pad: the cube must not slide when a hand feels its sides with 5 N
MARGIN_RAD = math.radians(8.0)
ABOVE_M = 0.20  # a pad is reachable with the hand over it up to this height
CARRY_M = 0.25  # height of the place before the arm
POINTS_DOWN, HEADING_DEG = -0.8, 15  # cosine of the hand's tilt; steps of the front of an arm
REACHES, BEARINGS_DEG = (0.6, 0.5, 0.7, 0.4, 0.8), (25.0, 35.0, 15.0, 50.0)
HEIGHTS, LOW = (1.0, 0.6), 0.3  # shares of the heights over the pads; the last one for arms with fewer than six joints
TABLES_M = (0.0, 0.2, 0.4, 0.7)  # by which the pads are higher, for arms whose hand does not point down near the floor
# Heights of the base of an arm for which no pads are found on the floor. Such arms are made for the edge of a table.
STANDS_M = (0.0, 0.3, 0.5)
STAND_M = 0.16  # side of what it then stands on
FREE_M = 0.01  # clearance of a posture that is chosen
FLAT_M = 0.005  # which a body may reach below its base: rounding of meshes
FAR_AWAY = "it does not reach them with its hand down"
STEPS, JUMP_RAD = 8, 0.6  # of a line down to a pad, 30 mm each at most; a joint that moves more is in another branch


@dataclass
class Draft:
    """A first cell and its files. `notes`: what was changed or assumed."""

    cell: Cell
    yaml: str
    files: dict[str, str]  # relative name -> text
    notes: list[str] = field(default_factory=list)


def draft(urdf: Path, name: str = "", tip: str = "") -> Draft:
    """The first cell for the arm of a URDF file. `name`: of the arm in sentences. Raises ProgramError."""
    if name and (problem := misnamed(name)):
        raise ProgramError(f"--name {name}: {problem}")
    stem = _plain(name or RobotFile(urdf).name)
    adapted = adapt(urdf, f"{stem}-hulls", tip)
    files = {f"{stem}.urdf": adapted.urdf, **adapted.hulls}
    files[f"{stem}.srdf"], notes = self_collisions.srdf(adapted.robot, files[f"{stem}.urdf"], files)
    adapted.notes += notes
    bare = _arm(adapted, stem, name or _title(adapted.robot.name))
    cell = Cell(name=stem, gravity_m_s2=GRAVITY, arms=[bare], objects=[_floor()], texts=files)
    _refuse_faults(adapted, cell)
    cell = _at_work(cell, adapted)
    return Draft(cell, _yaml(cell, adapted.notes), files, adapted.notes)


def _at_work(cell: Cell, adapted: AdaptedArm) -> Cell:
    """The cell with postures, pads and a cube. An arm whose hand points down below its base only is put on a stand."""
    foot_m, notes, first = _below_base_m(adapted), list(adapted.notes), None
    causes = Counter[str]()
    for stand_m in STANDS_M if len(adapted.joints) >= ARM_JOINTS else STANDS_M[:1]:
        adapted.notes[:] = notes
        posed = _with_postures(_on_stand(cell, stand_m, foot_m), adapted)
        placed = _with_pads(posed, adapted, (0.0,) if stand_m else TABLES_M, causes)
        if placed is not None:
            if stand_m:
                adapted.notes.append(f"it stands {100 * stand_m:.0f} cm high: its hand points down below its base only")
            return placed
        first = first or (posed, list(adapted.notes))
    assert first is not None
    cell, adapted.notes[:] = first
    hindrances = causes.copy()
    del hindrances[FAR_AWAY]  # at most places of most arms
    adapted.notes.append(
        "no pads were placed: no two places were found at which the hand points down freely, near the floor or up to "
        f"{PAD_HEIGHT_M + TABLES_M[-1]:g} m above it. Most often {(hindrances or causes).most_common(1)[0][0]}; add "
        "objects and seats yourself"
    )
    return cell


def _below_base_m(adapted: AdaptedArm) -> float:
    """How far the body at the base, and the first that moves on it with its clearance, reach below the origin."""
    robot, lowest = adapted.robot, 0.0
    for link, clear_m in ((robot.root, 0.0), (robot.child[adapted.joints[0]], FREE_M + FLAT_M)):
        if clouds := outline(adapted, link):
            pose = robot.pose_in(link, robot.root)
            lowest = min(lowest, float((np.vstack(clouds) @ pose[2, :3] + pose[2, 3]).min()) - clear_m)
    return -lowest if -lowest > FLAT_M else 0.0


def _on_stand(cell: Cell, stand_m: float, foot_m: float) -> Cell:
    """The cell with its arm so high. `foot_m`: what is below the origin of its base."""
    high_m = round(stand_m + foot_m + 0.0005, 3) if foot_m else stand_m
    if not high_m:
        return cell
    arm = msgspec.structs.replace(cell.arms[0], base=Frame(xyz=(0.0, 0.0, high_m)))
    if not stand_m:
        return msgspec.structs.replace(cell, arms=[arm])
    post = Box(
        name="post",
        size_m=(STAND_M, STAND_M, round(stand_m - 0.004, 3)),
        frame=Frame(xyz=(0.0, 0.0, round(0.5 * (stand_m - 0.004), 4))),
        colour=(0.62, 0.64, 0.66, 1.0),
    )
    stand = Object(name="STAND", kind="structure", fixed=True, mass_kg=100.0, shapes=[post])
    return msgspec.structs.replace(cell, arms=[arm], objects=[*cell.objects, stand])


def _refuse_faults(adapted: AdaptedArm, cell: Cell) -> None:
    """Raises ProgramError for an arm that a check of the cell would refuse, or that two readers read differently."""
    path = adapted.robot.path
    for one in of_urdf(path, in_cell=True, text=adapted.urdf):
        if one.severity == "error":
            raise ProgramError(f"{path}: {one.where}: {one.problem}; expected: {one.expected}")
    texts = {name: text for name, text in cell.texts.items() if name.endswith(hulls.SUFFIX)}
    found = two_readers.differences(cell.texts[cell.arms[0].urdf], texts, shapes=True)
    if found:
        where, problem, expected = found[0]
        others = f" (and {len(found) - 1} more)" if found[1:] else ""
        raise ProgramError(f"{path}: {where}: {problem}; expected: {expected}{others}")


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "arm"


def _title(text: str) -> str:
    """A name for sentences: capital letters, digits and hyphens."""
    plain = _plain(text).upper()
    plain = plain if plain[0].isalpha() else f"ARM-{plain}"
    return f"{plain}-1" if misnamed(plain) else plain


def _arm(adapted: AdaptedArm, stem: str, name: str) -> Arm:
    rest = [0.0] * len(adapted.joints)
    return Arm(
        name=name,
        end_effector=f"{name}-HAND",
        urdf=f"{stem}.urdf",
        srdf=f"{stem}.srdf",
        base=Frame(),
        joints=adapted.joints,
        tcp_link=TCP,
        sensor_joint=adapted.sensor,
        home_deg=_written(adapted, rest),
        stow_deg=_written(adapted, rest),
        acceleration_deg_s2=["1 m/s2" if _slides(adapted, joint) else 100.0 for joint in adapted.joints],
        payload_kg=1.0,
        gripper=_gripper(adapted),
    )


def _slides(adapted: AdaptedArm, joint: str) -> bool:
    return adapted.robot.type(joint) == "prismatic"


def _written(adapted: AdaptedArm, values: Array | list[float]) -> list[float | str]:
    """Joint values (rad, m) as in a cell file."""
    return [
        f"{value:.3f} m" if _slides(adapted, joint) else round(math.degrees(value), 1)
        for joint, value in zip(adapted.joints, np.asarray(values).tolist(), strict=True)
    ]


def _gripper(adapted: AdaptedArm) -> Gripper:
    limits = [adapted.robot.joints[joint].find("limit") for joint in adapted.fingers]
    opening = 2.0 * min(adapted.robot.limits(joint)[1] for joint in adapted.fingers)
    if not opening > 0.0:
        raise ProgramError(f"{adapted.robot.path}: the fingers must open with positive values of their joints")
    force_n = min(number(limit, "effort", GRIP_N) for limit in limits if limit is not None)
    speed_m_s = min(number(limit, "velocity", SPEED_M_S) for limit in limits if limit is not None)
    if force_n < GRIP_N:
        adapted.notes.append(
            f"the fingers have {force_n:g} N in the URDF; scripts grip with up to 45 N: the cell states {GRIP_N:g} N"
        )
    return Gripper(
        max_opening_m=round(opening, 4),
        max_force_n=max(force_n, GRIP_N),
        speed_m_s=min(speed_m_s, SPEED_M_S),
        finger_joints=adapted.fingers,
        finger_links=adapted.finger_links,
        palm_link=adapted.palm,
    )


def _floor() -> Object:
    top = Box(
        name="plate", size_m=(3.0, 3.0, 0.02), frame=Frame(xyz=(0.0, 0.0, -0.012)), colour=(0.62, 0.64, 0.66, 1.0)
    )
    return Object(name="FLOOR", kind="structure", fixed=True, mass_kg=100.0, shapes=[top])


# --- postures ------------------------------------------------------------------------------------------


def _with_postures(cell: Cell, adapted: AdaptedArm) -> Cell:
    """The cell with home, stow, accelerations and payload of its arm."""
    name = cell.arms[0].name
    model, world = ArmModel.of(cell, name), CollisionWorld(cell)
    drawn = list(_samples(model))
    hits = [world.check({name: q}, Scene(clearance_m=FREE_M)) for q in drawn]
    free = [q for q, hit in zip(drawn, hits, strict=True) if hit is None]
    held = np.array([q for q in free if _weight_share(model, q) < EFFORT])
    if not len(held):
        most = Counter(f"{hit.body_a} with {hit.body_b}" for hit in hits if hit is not None).most_common(1)
        collides = f"every sampled posture collides, most often {most[0][0]}" if most else ""
        why = "its motors cannot hold it against gravity" if free else collides
        raise ProgramError(f"{adapted.robot.path}: no posture of {name} was found: {why}")
    if len(free) < POSTURES / 20:
        adapted.notes.append(f"only {len(free)} of {POSTURES} postures are free of collisions")
    hands = np.array([model.fk(q) for q in held])
    tool = np.array([geometry.rotate(pose, (0.0, 0.0, 1.0)) for pose in hands])
    reach = float(np.linalg.norm(hands[:, :2], axis=1).max())
    margin = np.min(np.minimum(held - model.limits.lower, model.limits.upper - held), axis=1)
    singular = np.array([model.sigma_min(q) for q in held])
    high = hands[:, 2] - cell.arms[0].base.xyz[2]  # above the base
    before = np.linalg.norm(np.column_stack((hands[:, :2], high)) - (0.5 * reach, 0.0, 0.45 * reach), axis=1)
    home = held[int(np.argmin(before / reach - tool[:, 2] * -0.5 - np.clip(margin, 0, 0.4) - singular))]
    home = _unwound(model, home, model.middle)
    folded = np.array([_extent_m(model, q) for q in held]) / reach - np.clip(margin, 0, 0.2)
    near_home = _unwound(model, held, home)
    turns = np.abs(near_home - home).max(axis=1) / np.pi
    avoided = np.where((high < 0.2 * reach) | (turns > FAR), 1.0, 0.0)
    stow = near_home[int(np.argmin(folded + NEAR_HOME * turns + avoided))]
    spec = msgspec.structs.replace(
        cell.arms[0],
        home_deg=_written(adapted, home),
        stow_deg=_written(adapted, stow),
        acceleration_deg_s2=_accelerations(adapted, model, held),
        payload_kg=_payload_kg(model, held),
    )
    return msgspec.structs.replace(cell, arms=[spec])


def _samples(model: ArmModel) -> Iterator[Array]:
    lower, upper = model.limits.lower, model.limits.upper
    margin = np.minimum(MARGIN_RAD, 0.2 * (upper - lower))
    yield from np.random.default_rng(SEED).uniform(lower + margin, upper - margin, (POSTURES, len(lower)))


def _extent_m(model: ArmModel, q: Array) -> float:
    """The greatest distance of a joint or of the hand from the base."""
    data = model.model.createData()
    pin.framesForwardKinematics(model.model, data, q)
    places = [data.oMi[n].translation for n in range(1, model.model.njoints)] + [data.oMf[model.tcp_frame].translation]
    return float(np.linalg.norm(places, axis=1).max())


def _unwound(model: ArmModel, q: Array, near: Array) -> Array:
    """The same postures, one or rows of them, with whole turns taken off, so that joints are nearer to `near`.

    A joint that would then be beyond its limits stays.
    """
    turned = q - 2 * np.pi * np.round((q - near) / (2 * np.pi)) * ~np.array(model.slides)
    margin = np.minimum(MARGIN_RAD, 0.2 * (model.limits.upper - model.limits.lower))
    within = (turned >= model.limits.lower + margin) & (turned <= model.limits.upper - margin)
    return np.where(within, turned, q)


def _weight_share(model: ArmModel, q: Array) -> float:
    still = np.zeros((1, len(q)))
    return float((np.abs(model.torques(q[None], still, still)[0]) / model.limits.effort).max())


def _accelerations(adapted: AdaptedArm, model: ArmModel, held: Array) -> list[float | str]:
    """The acceleration that each motor can give to its joint alone in the worst of the postures, with a reserve."""
    least = np.full(len(adapted.joints), np.inf)
    for q in held[:200]:
        still = np.zeros((1, len(q)))
        weight = np.abs(model.torques(q[None], still, still)[0])
        own = np.abs(np.diag(model.mass_matrix(q)))
        least = np.minimum(least, ACCELERATION * (model.limits.effort - weight) / np.maximum(own, 1e-6))
    return [
        f"{value:.1f} m/s2" if _slides(adapted, joint) else float(5 * round(math.degrees(value) / 5))
        for joint, value in zip(adapted.joints, np.clip(least, *ACCELERATIONS).tolist(), strict=True)
    ]


def _payload_kg(model: ArmModel, held: Array) -> float:
    """The mass that the motors hold in the worst of the postures with half of what they have left."""
    least = np.inf
    for q in held[:200]:
        still = np.zeros((1, len(q)))
        weight = np.abs(model.torques(q[None], still, still)[0])
        per_kg = np.abs(model.jacobian(q)[2]) * abs(GRAVITY[2])
        least = min(least, float(((0.5 * (model.limits.effort - weight)) / np.maximum(per_kg, 1e-3)).min()))
    return round(float(np.clip(least, *PAYLOADS_KG)), 1)


# --- pads, cube and a place ----------------------------------------------------------------------------


def _with_pads(cell: Cell, adapted: AdaptedArm, tables_m: Sequence[float], causes: Counter[str]) -> Cell | None:
    """The cell with two pads on either side, a cube on the first, and a place between them; None: no such place, and
    `causes` has why not."""
    name, home = cell.arms[0].name, cell.arms[0].home_rad
    model, margin = ArmModel.of(cell, name), math.radians(cell.numbers.joint_margin_deg)
    hands = np.array([model.fk(q) for q in _samples(model)])
    farthest = float(np.linalg.norm(hands[:, :2], axis=1).max())
    down_at = _down_at(hands)
    ways = itertools.product(_layouts(cell, model, tables_m), _headings_deg(down_at), REACHES)
    for how, heading_deg, share in ways:
        heading, reach_m = math.radians(heading_deg), share * farthest
        down = (180.0, 0.0, how.hand_deg(heading))
        front = Frame(xyz=_at(reach_m, heading, how.pad_m + how.height * CARRY_M), rpy_deg=down)
        if front.xyz[2] > down_at[:, 2].max(initial=0.0) or not model.ik(front.pose, home, margin):
            causes[FAR_AWAY] += len(BEARINGS_DEG)
            continue  # at any bearing
        for bearing_deg in BEARINGS_DEG:
            bearing = math.radians(bearing_deg)
            pads = [_pad(f"PAD-{n}", reach_m, heading + sign * bearing, how) for n, sign in ((1, 1.0), (2, -1.0))]
            tried = msgspec.structs.replace(
                cell,
                seats=pads,
                objects=[*cell.objects, _cube(how)],
                places=[Place(name="FRONT", poses={name: front})],
                attitudes={"TOOL-DOWN": Frame(rpy_deg=down)},
            )
            cause = hindrance(tried, how.height * ABOVE_M)
            if not cause:
                return tried
            causes[cause] += 1
    return None


def _down_at(hands: Array) -> Array:
    """The places of the hands, one in each row, that point down."""
    tools = np.array([geometry.rotate(pose, (0.0, 0.0, 1.0)) for pose in hands])
    return hands[tools[:, 2] < POINTS_DOWN, :3]


def _headings_deg(down_at: Array) -> list[float]:
    """What may be the front of an arm: the x axis of its base, and where its hand points down in drawn postures."""
    x, y, _ = down_at.sum(axis=0)
    return list(dict.fromkeys((0.0, float(HEADING_DEG * round(math.degrees(math.atan2(y, x)) / HEADING_DEG)))))


def _at(reach_m: float, bearing: float, high_m: float) -> Vec3:
    return round(reach_m * math.cos(bearing), 3), round(reach_m * math.sin(bearing), 3), round(high_m, 3)


class _Layout(NamedTuple):
    """`yaw_deg`: of the hand that points down; `radial`: pads and cube turn with the bearing, as the hand of an arm
    does that cannot turn it; `height`: share of the usual heights over the pads; `table_m`: these are higher by it."""

    yaw_deg: float = 0.0
    radial: bool = False
    height: float = 1.0
    table_m: float = 0.0

    @property
    def pad_m(self) -> float:
        """The height of the pads above the floor."""
        return PAD_HEIGHT_M + self.table_m

    @property
    def quarter_deg(self) -> float:
        """The yaw of the hand on a cube whose sides are parallel to its fingers."""
        return 90.0 * round(self.yaw_deg / 90.0)

    def hand_deg(self, bearing: float) -> float:
        """The yaw of the hand at a bearing."""
        return self.yaw_deg + (math.degrees(bearing) if self.radial else 0.0)

    def turned_deg(self, bearing: float) -> float:
        """The yaw of the pads and of the cube on them, which the hand grasps square."""
        return self.hand_deg(bearing) - self.quarter_deg


def _layouts(cell: Cell, model: ArmModel, tables_m: Sequence[float]) -> Iterator[_Layout]:
    """Ways to place the pads. Of an arm with fewer than six joints the hand has the yaw that it has at home, seen from
    the world or from the base."""
    if len(model.joints) >= WHOLE:
        for table_m, height, yaw_deg in itertools.product(tables_m, HEIGHTS, (0.0, 90.0, 180.0, -90.0)):
            yield _Layout(yaw_deg, False, height, table_m)
        return
    hand = model.fk(cell.arms[0].home_rad)
    turned = geometry.to_matrix(hand)[:3, :3]
    x, y = turned[:, 0], turned[:, 1]
    yaw = math.atan2(y[0], -y[1]) if abs(y[2]) < abs(x[2]) else math.atan2(x[1], x[0])
    bearing = math.atan2(hand[1] - model.base_pose[1], hand[0] - model.base_pose[0])
    for table_m, height in itertools.product(tables_m, (*HEIGHTS, LOW)):
        yield _Layout(height=height, table_m=table_m)
        for half_turn in (0.0, 180.0):
            yield _Layout(round(math.degrees(yaw) + half_turn, 1), False, height, table_m)
            yield _Layout(round(math.degrees(yaw - bearing) + half_turn, 1), True, height, table_m)


def _pad(name: str, reach_m: float, bearing: float, how: _Layout) -> Seat:
    block = Box(
        name="block",
        size_m=(PAD_M, PAD_M, round(how.pad_m, 3)),
        frame=Frame(xyz=(0.0, 0.0, round(-0.5 * (how.pad_m + CUBE_M), 4))),
        colour=(0.45, 0.48, 0.52, 1.0),
    )
    return Seat(
        name=name,
        kind="pad",
        frame=Frame(
            xyz=_at(reach_m, bearing, how.pad_m + 0.5 * CUBE_M), rpy_deg=(0.0, 0.0, round(how.turned_deg(bearing), 3))
        ),
        way_out=(0.0, 0.0, 1.0),
        depth_m=0.02,
        detent_n=MAGNET_N,
        shapes=[block],
    )


def _cube(how: _Layout) -> Object:
    side = (CUBE_M, CUBE_M, CUBE_M)
    inertia = round(CUBE_KG * CUBE_M**2 / 6, 8)
    return Object(
        name="CUBE",
        kind="module",
        seat="PAD-1",
        mass_kg=CUBE_KG,
        inertia_kg_m2=(inertia, inertia, inertia),
        shapes=[Box(name="body", size_m=side, colour=(0.15, 0.45, 0.75, 1.0))],
        grasp_points=[
            GraspPoint(
                name="TOP",
                frame=Frame(xyz=(0.0, 0.0, ABOVE_MIDDLE_M), rpy_deg=(180.0, 0.0, how.quarter_deg)),
                width_m=CUBE_M,
            )
        ],
    )


def hindrance(cell: Cell, above_m: float) -> str:
    """Why the arm does not reach cube, both pads and the place, or does not come down to the pads from above; "" if it
    does."""
    name = cell.arms[0].name
    model, world = ArmModel.of(cell, name), CollisionWorld(cell)
    grasp = cell.object("CUBE").grasp_points[0].frame.pose
    aside = Scene(poses={"CUBE": geometry.make_pose((0.0, 0.0, -1.0))})
    margin = math.radians(cell.numbers.joint_margin_deg)
    goals = [(geometry.compose(cell.seated_pose(seat.name), grasp), above_m) for seat in cell.seats]
    for goal, way_m in ((cell.places[0].poses[name].pose, 0.0), *goals):
        line = [geometry.translate(goal, (0.0, 0.0, float(h))) for h in np.linspace(way_m, 0.0, STEPS if way_m else 1)]
        cause = FAR_AWAY
        for q in model.ik(line[0], cell.arms[0].home_rad, margin):
            cause = _hindrance_on(model, world, aside, line, q, margin)
            if not cause:
                break
        if cause:
            return cause
    return ""


def _hindrance_on(
    model: ArmModel, world: CollisionWorld, scene: Scene, line: list[Array], start: Array, margin: float
) -> str:
    rows = model.ik_along(line, start)
    if len(rows) < len(line) or np.abs(np.diff(rows, axis=0)).max(initial=0.0) > JUMP_RAD:
        return "the line down to them leaves its reach"  # it ends, or goes on in another branch
    for q in rows:
        if model.limit_margin_rad(q) < margin:
            return "a joint is at its limit there"
        if _weight_share(model, q) >= EFFORT:
            return f"its motors need more than {EFFORT:.0%} of their torque to hold it there"
        if (hit := world.check({model.name: q}, scene)) is not None:
            return f"{hit.body_a} touches {hit.body_b} there"
    return ""


# --- the file ------------------------------------------------------------------------------------------


def _yaml(cell: Cell, notes: list[str]) -> str:
    """The cell file, with comments."""
    plain = msgspec.to_builtins(msgspec.structs.replace(cell, texts={}))
    arm = plain["arms"][0]
    lines = [
        f"# The first cell of {arm['name']}, written by `rtc cell new`. Check it: rtc cell check FILE",
        "# World frame: z up; metres and degrees. What was changed or assumed:",
        *(f"#   {note}" for note in notes),
        f"name: {cell.name}",
        f"gravity_m_s2: {_flow(list(cell.gravity_m_s2))}",
        "",
        "arms:",
        *_block(arm, _ABOUT),
    ]
    for group in ("seats", "objects", "places"):
        if plain.get(group):
            lines += ["", f"{group}:"]
            for part in plain[group]:
                lines += _block(part, {})
    if "attitudes" in plain:
        lines += ["", "attitudes:", *(f"  {name}: {_flow(frame)}" for name, frame in plain["attitudes"].items())]
    return "\n".join(lines) + "\n"


_ABOUT = {
    "base": "pose of the root link, world frame",
    "tcp_link": "z out of the palm, y along the way of the first finger",
    "sensor_joint": "the fixed joint of a wrist sensor; null: joint torques measure contact",
    "acceleration_deg_s2": "proposed from the motor torques",
    "payload_kg": "proposed from the motor torques; see the data sheet",
}


def _block(part: dict[str, object], about: dict[str, str]) -> list[str]:
    """One item of a list in YAML: a line per field, its value in flow style."""
    if "sensor_joint" in about and "sensor_joint" not in part:
        part = {**part, "sensor_joint": "wrist_ft"}
    lines = []
    for n, (key, value) in enumerate(part.items()):
        comment = f"  # {about[key]}" if key in about else ""
        if isinstance(value, list) and value and isinstance(value[0], dict):
            lines.append(f"{'  - ' if n == 0 else '    '}{key}:")
            lines += [f"      - {_flow(item)}" for item in value]
        else:
            lines.append(f"{'  - ' if n == 0 else '    '}{key}: {_flow(value)}{comment}")
    return lines


def _flow(value: object) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.8f}".rstrip("0").rstrip(".")
    return str(value)
