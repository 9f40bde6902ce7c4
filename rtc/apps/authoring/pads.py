"""Two pads, a cube and a place for the first cell of an arm, where its hand points down freely.

Deterministic. This module must not know how an arm is read or a cell is written.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Box, Frame, GraspPoint, Object, Place, Seat, Vec3
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Scene
from rtc.model.robot.kinematics import ArmModel
from rtc.model.robot.numeric_ik import WHOLE
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

EFFORT = 0.6  # share of the motor torque that a posture may need against gravity
CUBE_M, CUBE_KG, PAD_M, PAD_HEIGHT_M = 0.04, 0.5, 0.12, 0.05
ABOVE_MIDDLE_M = 0.008  # of the cube is its grasp point, so that the finger tips do not touch the pad
MAGNET_N = 10.0  # of a pad: the cube must not slide when a hand feels its sides with 5 N
ABOVE_M = 0.20  # a pad is reachable with the hand over it up to this height
CARRY_M = 0.25  # height of the place before the arm
POINTS_DOWN, HEADING_DEG = -0.8, 15  # cosine of the hand's tilt; steps of the front of an arm
REACHES, BEARINGS_DEG = (0.6, 0.5, 0.7, 0.4, 0.8), (25.0, 35.0, 15.0, 50.0)
HEIGHTS, LOW = (1.0, 0.6), 0.3  # shares of the heights over the pads; the last one for arms with fewer than six joints
FAR_AWAY = "it does not reach them with its hand down"
STEPS, JUMP_RAD = 8, 0.6  # of a line down to a pad, 30 mm each at most; a joint that moves more is in another branch


def with_pads(cell: Cell, hands: Array, tables_m: Sequence[float], causes: Counter[str]) -> Cell | None:
    """The cell with two pads on either side, a cube on the first, and a place between them; None: no such place, and
    `causes` has why not."""
    name, home = cell.arms[0].name, cell.arms[0].home_rad
    model, margin = ArmModel.of(cell, name), math.radians(cell.numbers.joint_margin_deg)
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
        if weight_share(model, q) >= EFFORT:
            return f"its motors need more than {EFFORT:.0%} of their torque to hold it there"
        if (hit := world.check({model.name: q}, scene)) is not None:
            return f"{hit.body_a} touches {hit.body_b} there"
    return ""


def weight_share(model: ArmModel, q: Array) -> float:
    """The torque of the motor that has least left against gravity, as a share of its greatest."""
    still = np.zeros((1, len(q)))
    return float((np.abs(model.torques(q[None], still, still)[0]) / model.limits.effort).max())
