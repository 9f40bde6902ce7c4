"""Geometric paths without timing: lines in joint space, with rounded corners between them, and task-space lines. Pure.

A `Path` maps a parameter s from 0 to `length` to joint values. Along a task line s is in metres of the tcp, or
`METRES_PER_RAD` per radian if rotation dominates. Along a joint path it has no unit. A line that cannot be followed is
refused with the place and the cause.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import msgspec
import numpy as np

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import causes
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion import smooth
from workers.planning.motion.blended import Blended, lengths, widest
from workers.planning.motion.spline import Spline

LONGEST_M = 1e3  # no arm goes so far; the line is not computed
KNOT_M = 0.025  # distance between inverse solutions; a cubic through them is straight to some micrometres
KNOT_RAD = 0.10
LEAP_RAD = 0.60  # a larger joint step between knots means a singularity or another branch
METRES_PER_RAD = 0.25  # so that 0.25 m/s means 1 rad/s where the hand only turns
SAME_M, SAME_RAD = 1e-4, 1e-4  # places of a sentence that are nearer to each other than this are one
NO_STEP_M = 1e-7  # poses of a curve that are nearer than this are one
FEWEST = 4  # poses of a curve; through fewer there is a line
CHECK_RAD = 0.025  # joint step between collision checks, weighted below; some 2 cm at the hand


@dataclass(frozen=True, eq=False)
class Path:
    """Joint values (rad) over s. Without a curve: a line from the first knot to the last.

    A `Spline` passes through `knots[k]` at `s[k]`; of a `Blended` curve the inner knots are the corners.
    """

    space: Literal["joint", "task"]
    s: Array  # rises from 0 to `length`
    knots: Array  # [len(s)][joints]
    curve: Blended | Spline | None

    @property
    def length(self) -> float:
        return float(self.s[-1])

    @property
    def is_a_point(self) -> bool:
        return bool(np.abs(self.knots - self.knots[0]).max() < 1e-9)

    def joints_at(self, s: Array) -> Array:
        """Joints, [len(s)][joints]."""
        if self.curve is not None:
            return self.curve(s)
        return self.knots[0] + s[:, None] * ((self.knots[-1] - self.knots[0]) / self.length)

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """Joints, and their first and second derivative by s, each [len(s)][joints]."""
        if self.curve is not None:
            return self.curve.at(s)
        slope = (self.knots[-1] - self.knots[0]) / self.length
        q = self.knots[0] + s[:, None] * slope
        return q, np.zeros(q.shape) + slope, np.zeros(q.shape)

    def dense(self, step_rad: float = CHECK_RAD, weights: Array | float = 1.0) -> tuple[Array, Array]:
        """(s, joints) at a spacing for collision checks.

        Between neighbours each joint, times its weight, moves at most `step_rad`. `weights`: `ArmModel.step_weights`.
        """
        turned = np.abs(self.knots[1:] - self.knots[:-1])
        counts = ((turned * weights).max(axis=1) / step_rad).tolist()
        if len(counts) == 1:
            s = even(0.0, self.length, max(1, math.ceil(counts[0])))
            return s, self.joints_at(s)
        places: list[float] = []  # a list, because numpy takes longer for so few values
        for (first, last), count in zip(pairwise(self.s.tolist()), counts, strict=True):
            pieces = max(1, math.ceil(count))
            step = (last - first) / pieces
            places += [n * step + first for n in range(pieces)]
        s = np.array([*places, self.length])
        return s, self.joints_at(s)

    def off_chords(self, s: Array) -> Array:
        """Upper bounds of the distance between the path and its chords between these s, [len(s) - 1][joints]; empty for
        a line. `s`: as of `dense`."""
        return np.empty((0, 0)) if self.curve is None else self.curve.off_chords(s)


def even(first: float, last: float, count: int) -> Array:
    """`count` + 1 evenly spaced values: `np.linspace` without its overhead."""
    values: Array = np.arange(count + 1, dtype=float) * ((last - first) / count) + first
    values[-1] = last
    return values


def distinct(points: Sequence[Floats] | Array, apart: Callable[[Array, Array], float], least: float) -> Array:
    """The points without those that are nearer than `least` to the one before: equal neighbours are one point, for a
    piece without length has no direction. The first and the last point stay, so there are at least two."""
    rows = np.array(points, dtype=float)
    kept = [0]
    for n in range(1, len(rows) - 1):
        if apart(rows[kept[-1]], rows[n]) >= least:
            kept.append(n)
    while len(kept) > 1 and apart(rows[kept[-1]], rows[-1]) < least:
        kept.pop()
    return rows[[*kept, -1]]


def distinct_postures(postures: Sequence[Floats]) -> Array:
    """`distinct` for joint values (rad)."""
    return distinct(postures, _turned, SAME_RAD)


def _turned(a: Array, b: Array) -> float:
    return float(np.abs(b - a).max())


def _moved(a: Array, b: Array) -> float:
    """The length between two poses, with the turn (m)."""
    return max(geometry.distance(a, b), METRES_PER_RAD * geometry.angle(a, b))


def joint_line(start: Floats, goal: Floats) -> Path:
    """Straight line in joint space from `start` to `goal` (rad)."""
    return Path("joint", np.array((0.0, 1.0)), np.array((start, goal), dtype=float), None)


def through(corners: Sequence[Floats], radii: Array | None = None) -> Path:
    """Lines in joint space between these postures (rad), with rounded corners; s is the largest joint displacement.

    `radii`: of the corners, in the unit of s; as wide as possible without them.
    """
    knots = np.array(corners, dtype=float) if radii is not None else distinct_postures(corners)
    if len(knots) == 2:
        return joint_line(knots[0], knots[1])
    s = lengths(knots)
    return Path("joint", s, knots, Blended(s, knots, widest(s) if radii is None else radii))


def spline_through(postures: Sequence[Floats]) -> Path:
    """A smooth curve in joint space through these postures (rad); s is as that of `through`."""
    knots = distinct_postures(postures)
    if len(knots) == 2:
        return joint_line(knots[0], knots[1])
    s, table = smooth.through(lengths(knots), knots)
    return Path("joint", s, table, Spline(s, table))


def poses_through(poses: Sequence[Floats]) -> Array:
    """A smooth curve of the tcp through these poses, as the table of `task_curve`."""
    rows = distinct(poses, _moved, SAME_M)
    for n in range(1, len(rows)):  # q and -q are the same attitude: take the nearer one
        if rows[n, 3:] @ rows[n - 1, 3:] < 0.0:
            rows[n, 3:] *= -1.0
    steps = [max(_moved(a, b), NO_STEP_M) for a, b in pairwise(rows)]
    per_piece = max(smooth.PER_PIECE, math.ceil(max(steps) / KNOT_M))
    _, table = smooth.through(np.concatenate(((0.0,), np.cumsum(steps))), rows, per_piece)
    return np.array([geometry.normalise(row) for row in table])


def task_line(arm: ArmModel, start: Floats, goal_pose: Floats, margin_rad: float = 0.0) -> Path:
    """Straight tcp line with uniform rotation from the pose of `start` (rad) to `goal_pose` (world), on one branch.

    Raises Refused."""
    start_pose = arm.fk(start)
    metres, turn = geometry.distance(start_pose, goal_pose), geometry.angle(start_pose, goal_pose)
    if not metres <= LONGEST_M:  # from a program or a fact; sentences have no such lengths
        problem = _problem(arm, np.asarray(goal_pose, dtype=float), None, np.asarray(start, dtype=float), margin_rad)
        assert problem is not None
        raise _at(problem, 1.0, metres, metres, turn)
    length = max(metres, METRES_PER_RAD * turn, 1e-9)
    count = max(4, math.ceil(metres / KNOT_M), math.ceil(turn / KNOT_RAD)) + 1
    fractions = even(0.0, 1.0, count - 1)
    table = np.concatenate((np.asarray([start], dtype=float), arm.ik_line(start_pose, goal_pose, fractions[1:], start)))
    n = _first_problem(arm, table, margin_rad)
    if n < count:
        pose = geometry.interpolate_all(start_pose, goal_pose, fractions[n : n + 1])[0]
        problem = _problem(arm, pose, table[n] if n < len(table) else None, table[n - 1], margin_rad)
        assert problem is not None
        fraction = float(fractions[n])
        raise _at(problem, fraction, fraction * metres, metres, turn)
    return Path("task", fractions * length, table, Spline(fractions * length, table))


def task_curve(arm: ArmModel, start: Floats, poses: Array, margin_rad: float = 0.0) -> Path:
    """The tcp through these poses (world, [poses][7], the first where `start` is), on one branch.

    Raises Refused."""
    poses = distinct(poses, _moved, NO_STEP_M)
    if len(poses) < FEWEST:
        return task_line(arm, start, poses[-1], margin_rad)
    metres = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    turns = np.array([geometry.angle(a, b) for a, b in pairwise(poses)])
    s = np.concatenate(((0.0,), np.cumsum(np.maximum(metres, METRES_PER_RAD * turns))))
    table = np.vstack((np.asarray(start, dtype=float), arm.ik_along(poses[1:], start)))
    n = _first_problem(arm, table, margin_rad)
    if n < len(poses):
        problem = _problem(arm, poses[n], table[n] if n < len(table) else None, table[n - 1], margin_rad)
        assert problem is not None
        raise _at(problem, float(s[n] / s[-1]), float(metres[:n].sum()), float(metres.sum()), float(turns.sum()))
    return Path("task", s, table, Spline(s, table))


def _first_problem(arm: ArmModel, table: Array, margin_rad: float) -> int:
    """Index of the first row after the start that leaps or passes a limit; the number of rows if there is none."""
    rows = table[1:]
    bad = np.abs(rows - table[:-1]).max(axis=1) > LEAP_RAD
    lower, upper = arm.bounds(margin_rad)
    bad |= ((rows < lower) | (rows > upper)).any(axis=1)
    return int(bad.argmax()) + 1 if bad.any() else len(table)


def _problem(arm: ArmModel, pose: Array, q: Array | None, before: Array, margin_rad: float) -> Refusal | None:
    if q is None:
        return arm.why_no_ik(pose, margin_rad) or Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"{arm.name} cannot follow the line on from here: only another branch continues there",
            clears=by_person("another branch or attitude at the start"),
            cause=causes.Singular(arm=arm.name, sigma_min=arm.sigma_min(before)),
        )
    leap = np.abs(q - before)
    if leap.max() > LEAP_RAD:
        joint = int(leap.argmax())
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=(
                f"{arm.name} would have to leap: {arm.joints[joint]} by {arm.shown(joint, leap[joint])} at once, "
                f"near a singularity"
            ),
            clears=by_person("another branch or attitude at the start"),
            cause=causes.Singular(
                arm=arm.name,
                joint=arm.joints[joint],
                leap_rad=float(leap[joint]),
                sigma_min=arm.sigma_min(before),
            ),
        )
    return arm.why_not_within(q, margin_rad)


def _at(problem: Refusal, fraction: float, metres: float, length_m: float, turn_rad: float) -> Refused:
    if length_m >= 0.001:
        where = f"{fraction:.0%} along the line, after {metres * 1000:.0f} mm of {length_m * 1000:.0f} mm"
    else:  # the hand turns where it is
        turn_deg = math.degrees(turn_rad)
        where = f"{fraction:.0%} of the turn, after {fraction * turn_deg:.0f} deg of {turn_deg:.0f} deg"
    placed = msgspec.structs.replace(
        problem,
        message=f"{problem.message} ({where})",
        where=where,
        fraction=fraction,
        along_m=metres,
    )
    return Refused(placed)
