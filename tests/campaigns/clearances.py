"""Distances between the bodies of a cell along an executed trajectory: a judge of the planner, with code of its own.

The distances are those of coal between all pairs of convex pieces, at postures so dense that no piece moves more than
`STEP_M` between two. Only pairs whose balls are farther apart than `FAR_M` are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from rtc.model.cells.cell import Cell
from rtc.model.robot import bodies
from rtc.protocol.primitive import JointTrajectory
from rtc.spatial.geometry import Array, Floats

STEP_M = 0.0033  # a third of the planner's step for a held body
FAR_M = 0.025  # distances beyond this are not measured
FINE = 8  # postures of a piece between two knots, from which the lengths are measured


@dataclass(frozen=True)
class Placed:
    """Where everything is while one arm moves."""

    arm: str
    joints: Mapping[str, Floats]  # of all arms (rad); the moving one's are replaced
    openings_m: Mapping[str, float]
    poses: Mapping[str, Floats] = field(default_factory=dict)  # of seats and objects, world; others as in the cell
    held: Mapping[str, tuple[str, Floats]] = field(default_factory=dict)  # object -> arm, pose in the axes of its tcp


class Least(NamedTuple):
    """The least distance of a pair along a trajectory; `share`: where, of its duration."""

    distance_m: float
    body_a: str
    body_b: str
    share: float


class Clearances:
    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._made = bodies.build(cell)
        self._data = self._made.model.createData()
        pieces, items = self._made.pieces, self._made.geometry.geometryObjects
        self._solids = [item.geometry for item in items]
        self._joint = [item.parentJoint for item in items]
        self._placement = [item.placement.copy() for item in items]
        self._owner = np.array([piece.owner for piece in pieces])
        for solid in self._solids:
            solid.computeLocalAABB()
        self._centre = np.array([np.asarray(solid.aabb_center) for solid in self._solids])
        self._radius = np.array([float(solid.aabb_radius) for solid in self._solids])
        self._pairs = np.array(self._made.pairs, dtype=int)

    def least(self, placed: Placed, trajectory: JointTrajectory, may_touch: set[frozenset[str]]) -> Least:
        """The nearest pair of the moving arm or what it holds with any other body, or of a held body with its own arm.

        `may_touch`: pairs of owners that are left out. The hand may touch what it holds.
        """
        slots = self._made.arms[placed.arm]
        joint, placement = self._placed(placed)
        pairs = self._watched(placed, may_touch)
        q = pin.neutral(self._made.model)
        for name, arm in self._made.arms.items():
            q[arm.joints] = placed.joints[name]
            q[arm.fingers] = 0.5 * placed.openings_m[name]
        rows = self._rows(trajectory, q, joint, placement, placed.arm)
        best = Least(FAR_M, "", "", 0.0)
        for n, row in enumerate(rows):
            q[slots.joints] = row
            at = self._at(q, joint, placement)
            centres = np.array([pose.act(centre) for pose, centre in zip(at, self._centre, strict=True)])
            balls_m = self._radius[pairs[:, 0]] + self._radius[pairs[:, 1]]
            apart_m = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1) - balls_m
            for a, b in pairs[apart_m < best.distance_m].tolist():
                distance_m = self._distance(a, b, at)
                if distance_m < best.distance_m:
                    label, other = (self._made.pieces[i].label for i in (a, b))
                    best = Least(distance_m, label, other, n / max(1, len(rows) - 1))
        return best

    def _distance(self, a: int, b: int, at: list[pin.SE3]) -> float:
        poses = [coal.Transform3s(at[i].rotation, at[i].translation) for i in (a, b)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return float(coal.distance(self._solids[a], poses[0], self._solids[b], poses[1], request, result))

    def _placed(self, placed: Placed) -> tuple[list[int], list[pin.SE3]]:
        """Parent joint and placement of every piece."""
        joint, placement = list(self._joint), list(self._placement)
        for n, piece in enumerate(self._made.pieces):
            if piece.owner in placed.held:
                holder, pose = placed.held[piece.owner]
                hand = self._made.arms[holder]
                joint[n], placement[n] = hand.hand_joint, hand.tcp * bodies.se3(pose) * piece.in_owner
            elif piece.owner in placed.poses:
                placement[n] = bodies.se3(placed.poses[piece.owner]) * piece.in_owner
        return joint, placement

    def _watched(self, placed: Placed, may_touch: set[frozenset[str]]) -> Array:
        mine = {placed.arm, *(name for name, (arm, _) in placed.held.items() if arm == placed.arm)}
        hand = self._made.arms[placed.arm].hand_joint
        pieces = self._made.pieces
        watched = []
        for a, b in self._pairs.tolist():
            kinds, owners = {pieces[a].kind, pieces[b].kind}, {pieces[a].owner, pieces[b].owner}
            moves = [n for n in (a, b) if pieces[n].owner in mine and pieces[n].kind != "base"]
            if "region" in kinds or not moves or len(owners) == 1 or frozenset(owners) in may_touch:
                continue
            if owners <= mine:  # a held body and its own arm: the links at the hand move with it
                link = a if pieces[a].owner == placed.arm else b
                if self._joint[link] == hand or pieces[link].part in self._made.arms[placed.arm].hand_links:
                    continue
            watched.append((a, b))
        return np.array(watched, dtype=int).reshape(-1, 2)

    def _at(self, q: Array, joint: list[int], placement: list[pin.SE3]) -> list[pin.SE3]:
        pin.forwardKinematics(self._made.model, self._data, q)
        return [self._data.oMi[j] * own if j else own for j, own in zip(joint, placement, strict=True)]

    def _rows(
        self, trajectory: JointTrajectory, q: Array, joint: list[int], placement: list[pin.SE3], arm: str
    ) -> Array:
        """Postures along the quintic polynomials, so dense that no point of a piece moves more than `STEP_M` or so."""
        slots = self._made.arms[arm].joints
        knots = zip(*_knots(trajectory), strict=True)
        dense = [_quintic(float(t), begin, end, np.linspace(0.0, 1.0, FINE + 1)[:-1]) for t, begin, end in knots]
        rows = np.vstack((*dense, trajectory.positions[-1]))
        moving = [n for n, j in enumerate(joint) if j and self._moves(j, slots)]
        joint, placement = [joint[n] for n in moving], [placement[n] for n in moving]
        centres, radii = self._centre[moving], self._radius[moving, None, None]
        places = []
        for row in rows:
            q[slots] = row
            at = self._at(q, joint, placement)
            middles = [pose.act(centre) for pose, centre in zip(at, centres, strict=True)]
            places.append(np.array(middles)[:, :, None] + np.array([pose.rotation for pose in at]) * radii)
        moved = np.linalg.norm(np.diff(np.array(places), axis=0), axis=2).max(axis=(1, 2))
        along = np.concatenate(((0.0,), np.cumsum(moved)))
        even = np.linspace(0.0, along[-1], max(2, int(np.ceil(along[-1] / STEP_M)) + 1))
        return np.column_stack([np.interp(even, along, rows[:, n]) for n in range(rows.shape[1])])

    def _moves(self, joint: int, slots: list[int]) -> bool:
        """Whether a joint carries a piece of the arm with these values of the configuration."""
        while joint > 0:
            if self._made.model.joints[joint].idx_q in slots:
                return True
            joint = self._made.model.parents[joint]
        return False


def _knots(trajectory: JointTrajectory) -> tuple[Array, Array, Array]:
    """Duration, and position, velocity and acceleration at both ends, of each polynomial."""
    rows = np.stack([np.asarray(x) for x in (trajectory.positions, trajectory.velocities, trajectory.accelerations)], 1)
    return np.diff(np.asarray(trajectory.time_s)), rows[:-1], rows[1:]


def _quintic(t: float, begin: Array, end: Array, u: Array) -> Array:
    """Positions at the shares `u` of a quintic with these ends ([position, velocity, acceleration][joints])."""
    u = u[:, None]
    p0, v0, a0 = begin[0], begin[1] * t, begin[2] * t * t
    p1, v1, a1 = end[0], end[1] * t, end[2] * t * t
    d, dv, da = p1 - p0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    c3, c4, c5 = 10 * d - 4 * dv + 0.5 * da, -15 * d + 7 * dv - da, 6 * d - 3 * dv + 0.5 * da
    found: Array = p0 + v0 * u + 0.5 * a0 * u**2 + c3 * u**3 + c4 * u**4 + c5 * u**5
    return found
