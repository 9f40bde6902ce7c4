"""The current scene as believed and (with a simulator) as true, and the request to draw it.

Believed: objects from the world's facts, arms as measured last, a held object where its hand is. Poses are
`[x y z qx qy qz qw]` (m, world frame), joints rad, fingers m. Knows no socket and no renderer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera
from rtc.protocol import messages as m
from rtc.spatial import geometry
from rtc.world.facts import Facts
from rtc.world.model import World

VIEWS = (
    "overview",
    "above",
    "behind",
    "left",
    "right",
    "top",
)  # --camera; or the name of a thing, for a close view of it

STEEP_DEG = 89.9


class SceneView(msgspec.Struct, frozen=True, kw_only=True):
    """Where everything is. An object, seat or arm that is missing is drawn as the cell begins."""

    poses: dict[str, list[float]] = {}
    joints: dict[str, list[float]] = {}
    fingers: dict[str, list[float]] = {}  # arm -> its two finger joints
    tcp: dict[str, list[float]] = {}
    seats: dict[str, list[float]] = {}
    blind: list[str] = []  # cameras whose pictures are black


class Panel(msgspec.Struct, frozen=True, kw_only=True):
    """One view of one scene. `labels`: name of an object or arm -> words beside it. `doubtful`: names whose label is
    drawn as a warning. `outlined`: objects whose outline in the first panel is drawn over this one."""

    title: str
    scene: SceneView
    labels: dict[str, str] = {}
    doubtful: list[str] = []
    outlined: list[str] = []


class Picture(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """What a renderer is asked for: panels side by side, lines of text below, a PNG or JPEG (.jpg) file."""

    out: str
    cell: str
    panels: list[Panel]
    camera: str = "overview"
    caption: list[str] = []
    smooth: bool = True  # draw twice as large and average: four times the work


class CameraPicture(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """A request to a renderer: the picture of a camera of the cell, without any text. A file .npy gets the pixels as an
    array. `scene` needs the tcp of the arm that carries the camera. `seed`: of the noise; none: a new one for each
    picture. `windows`: only these parts, each x, y, width and height in pixels of the whole picture. The file must be a
    .npy; it gets their pixels one after another."""

    out: str
    cell: str
    camera: str
    scene: SceneView
    seed: int | None = None
    windows: list[tuple[int, int, int, int]] = []


class Drawn(msgspec.Struct, frozen=True, kw_only=True):
    """A renderer's answer: the file is there, or why not."""

    error: str = ""


class ObjectRow(msgspec.Struct, frozen=True, kw_only=True):
    """One object, believed against true. `off_m` and `turned_rad` are absent where the truth is not known."""

    name: str
    pose: list[float]
    validity: m.Validity
    where: str  # RACK-1, in RIGHT-ARM's hand, or empty: in neither
    true_pose: list[float] | None = None
    off_m: float | None = None
    turned_rad: float | None = None

    @property
    def doubt(self) -> str:
        """The validity of its pose in brackets; empty for a valid one."""
        return "" if self.validity is m.Validity.VALID else f" ({self.validity.value})"


class ArmRow(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    tcp: list[float] | None  # not known without telemetry
    hand_width_m: float
    holding: str
    truly_holding: list[str] | None = None
    moving: str = ""  # the primitive it executes


class Believed(msgspec.Struct, frozen=True, kw_only=True):
    scene: SceneView
    arms: list[ArmRow]
    objects: list[ObjectRow]

    @property
    def panel(self) -> Panel:
        """It with what each arm holds, and which objects are in doubt."""
        labels = {arm.name: arm.name + (f" holds {arm.holding}" if arm.holding else "") for arm in self.arms}
        labels |= {row.name: row.name + row.doubt for row in self.objects}
        doubtful = [row.name for row in self.objects if row.doubt]
        return Panel(title="believed", scene=self.scene, labels=labels, doubtful=doubtful)


def believed(
    cell: Cell, facts: Mapping[str, m.Fact], measured: Mapping[str, m.ArmSample], truth: m.SimTruthReply | None
) -> Believed:
    """The scene of these facts (by key) and of the arms as measured; compared with the truth where it is known."""

    known = Facts(cell, World(facts=facts))
    arms, joints, fingers, tcp = [], {}, {}, {}
    for arm in cell.arms:
        sample = measured.get(arm.name)
        joints[arm.name] = sample.joints if sample else list(known.joints(arm.name))
        wide_m = sample.hand_width_m if sample else known.hand_width(arm.name)
        fingers[arm.name] = [0.5 * wide_m, 0.5 * wide_m]
        if sample:
            tcp[arm.name] = sample.tcp_pose
        arms.append(
            ArmRow(
                name=arm.name,
                tcp=tcp.get(arm.name),
                hand_width_m=wide_m,
                holding=known.holding(arm.name),
                truly_holding=truth.held.get(arm.name, []) if truth else None,
                moving=sample.primitive if sample else "",
            )
        )
    objects = []
    for thing in cell.objects:
        fact, holder = facts.get(f"{thing.name}.frame"), known.held_by(thing.name)
        held = known.in_hand(thing.name, tcp[holder]) if holder in tcp else None
        pose = (known.frame(thing.name) if held is None else held).tolist()
        true_pose = truth.poses.get(thing.name) if truth else None
        objects.append(
            ObjectRow(
                name=thing.name,
                pose=pose,
                validity=fact.validity if fact else m.Validity.UNKNOWN,
                where=f"{holder}'s hand" if holder else known.seat(thing.name),
                true_pose=true_pose,
                off_m=geometry.distance(pose, true_pose) if true_pose else None,
                turned_rad=geometry.angle(pose, true_pose) if true_pose else None,
            )
        )
    scene = SceneView(
        poses={row.name: row.pose for row in objects},
        joints=joints,
        fingers=fingers,
        tcp=tcp,
        seats={seat.name: known.seat_frame(seat.name).tolist() for seat in cell.seats},
    )
    return Believed(scene=scene, arms=arms, objects=objects)


def true_scene(truth: m.SimTruthReply) -> SceneView:
    return msgspec.convert(truth, SceneView, from_attributes=True)


def request_camera(cameras: Sequence[Camera], arm: str, seen: m.ArmSample) -> str:
    """The camera for the picture of a request to the operator: the one on this hand, else the fixed one whose axis
    passes nearest to where it shall go. Empty: there is neither."""
    if carried := next((one.name for one in cameras if one.arm == arm), ""):
        return carried
    goal = (seen.operation.centre if seen.operation is not None else []) or seen.tcp_pose[:3]

    def off_axis(camera: Camera) -> float:
        axis = np.subtract(camera.looks_at, camera.xyz)
        way = np.subtract(goal, camera.xyz)
        along = float(axis @ way) / float(np.linalg.norm(axis))
        return float(np.linalg.norm(way)) / along if along > 0.0 else math.inf  # 1 on the axis

    fixed = [one for one in cameras if one.arm is None]
    return min(fixed, key=off_axis).name if fixed else ""


# --- for people ----------------------------------------------------------------------------------------


def centimetres(point: geometry.Floats) -> str:
    """80 -80.5 60: a position in cm, to a tenth of a millimetre."""
    return " ".join(f"{round(100.0 * float(n), 2) + 0.0:g}" for n in list(point)[:3])


def degrees(pose: geometry.Floats) -> str:
    """0 90 -45.5: roll pitch yaw of a pose. At a pitch of about 90 deg only the sum of roll and yaw is defined: the yaw
    is 0 then."""
    roll, pitch, yaw = (math.degrees(n) for n in geometry.to_rpy(pose).tolist())
    if abs(pitch) > STEEP_DEG:
        roll, yaw = (roll - math.copysign(yaw, yaw * pitch) + 180.0) % 360.0 - 180.0, 0.0
    return " ".join(f"{round(n, 1) + 0.0:g}" for n in (roll, pitch, yaw))
