"""The first cell of an arm: what its URDF does not state is sampled or computed. Deterministic.

The arm stands on a floor under gravity, before two pads and a cube, so that MOVE, GRASP and PLACE work at once.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import pinocchio as pin

from rtc.apps.authoring import pads, self_collisions
from rtc.apps.authoring.adapt import ARM_JOINTS, TCP, AdaptedArm, adapt, outline
from rtc.apps.authoring.review import of_urdf
from rtc.apps.authoring.robot_file import RobotFile
from rtc.apps.authoring.words_and_keys import name_problem
from rtc.model.cells import two_readers
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Arm, Box, Frame, Gripper, Object
from rtc.model.cells.urdf import number
from rtc.model.robot import hulls
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

SEED, POSTURES = 1, 1500  # among which home and stow are chosen
FAR = 0.9  # half turns of a joint from home to stow, at most if the arm allows it
NEAR_HOME = 0.06  # weight of half a turn of a joint from home, against a reach more of extent, for stow
ACCELERATION = 0.4  # share of the remaining motor torque that accelerates the joint alone
ACCELERATIONS = (0.5, 10.0)  # rad/s^2, m/s^2: range of what is proposed
PAYLOADS_KG = (0.5, 10.0)
GRAVITY = (0.0, 0.0, -9.81)
GRIP_N, SPEED_M_S = 60.0, 0.05  # of a hand whose URDF states none
MARGIN_RAD = math.radians(8.0)
TABLES_M = (0.0, 0.2, 0.4, 0.7)  # by which the pads are higher, for arms whose hand does not point down near the floor
# Heights of the base of an arm for which no pads are found on the floor. Such arms are made for the edge of a table.
STANDS_M = (0.0, 0.3, 0.5)
STAND_M = 0.16  # side of what it then stands on
FREE_M = 0.01  # clearance of a posture that is chosen
FLAT_M = 0.005  # which a body may reach below its base: rounding of meshes


@dataclass
class Draft:
    """A first cell and its files. `notes`: what was changed or assumed."""

    cell: Cell
    yaml: str
    files: dict[str, str]  # relative name -> text
    notes: list[str] = field(default_factory=list)


def draft(urdf: Path, name: str = "", tip: str = "") -> Draft:
    """The first cell for the arm of a URDF file. `name`: of the arm in sentences. Raises ProgramError."""
    if name and (problem := name_problem(name)):
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
        hands = _hands(ArmModel.of(posed, posed.arms[0].name))
        placed = pads.with_pads(posed, hands, (0.0,) if stand_m else TABLES_M, causes)
        if placed is not None:
            if stand_m:
                adapted.notes.append(f"it stands {100 * stand_m:.0f} cm high: its hand points down below its base only")
            return placed
        first = first or (posed, list(adapted.notes))
    assert first is not None
    cell, adapted.notes[:] = first
    hindrances = causes.copy()
    del hindrances[pads.FAR_AWAY]  # at most places of most arms
    why = (hindrances or causes).most_common(1)[0][0]
    adapted.notes.append(
        "no pads were placed: no two places were found at which the hand points down freely, near the floor or up to "
        f"{pads.PAD_HEIGHT_M + TABLES_M[-1]:g} m above it. Most often {why}; add objects and seats yourself"
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
        adapted.notes.append(f"{one.where}: {one.problem}")
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
    return f"{plain}-1" if name_problem(plain) else plain


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
    held = np.array([q for q in free if pads.weight_share(model, q) < pads.EFFORT])
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


def _hands(model: ArmModel) -> Array:
    """The poses of the hand in the drawn postures."""
    return np.array([model.fk(q) for q in _samples(model)])


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
