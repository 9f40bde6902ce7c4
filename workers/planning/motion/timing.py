"""Time parametrization: converts a path to timed knots, at rest at both ends, within all limits.

A line gets a closed-form jerk-limited profile along its parameter; in joint space its pieces are the knots. A curve
through way-points gets the time-optimal profile within the joint limits (`pace`; with torque limits toppra). A single
pace would be limited by the sharpest bend. Joint limits of speed, acceleration and torque and the tcp's speed limit
hold everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from rtc.model.robot import quintic
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.knots import Knots
from rtc.protocol.primitive import JointTrajectory, Load
from rtc.spatial.geometry import Array
from workers.planning.motion.blended import Blended
from workers.planning.motion.pace import fastest
from workers.planning.motion.path import Path, even
from workers.planning.motion.rest_to_rest import PIECES, rest_to_rest
from workers.planning.motion.spline import Spline
from workers.planning.motion.torques import Torques

KNOT_S = 0.03  # knot spacing; the quintic Hermite error is some micrometres
KNOT_M = 0.0075  # minimum knot distance at constant speed, so that slow motions have few knots
RAMP_S = 0.1  # time from zero to full acceleration
CURVE_RAMP_S = 0.5  # duration of dense knots at each end of a curve
GRID = 61  # grid points of the curve solver
CORNER_GRID = 4  # grid points between the edges of two rounded corners
GRID_STEP = 1e-7  # minimum distance of two grid points, as a share of the path's length
STILL = 1e-8  # a joint that turns less than this along the path has no speed limit
TOLERANCE = 1.03  # of the tcp's speed limit on a curve
BETWEEN = 0.98  # of the tcp's speed limit at the points of the grid; the rest is a reserve between them
SAMPLES = 33  # path samples at which limits are evaluated, at most for a line in joint space
SAMPLE_RAD, LEAST_SAMPLES = 0.1, 3  # spacing of those of a line in joint space; their number for a short one
SAMPLED = 100  # intervals of a motion at whose ends its torques are evaluated


@dataclass(frozen=True)
class SpeedLimits:
    """Speed and acceleration limits of the tcp, and the usable fraction of the joint limits."""

    speed_m_s: float = 0.25
    acceleration_m_s2: float = 1.0
    ratio: float = 1.0


NO_SPEED_LIMITS = SpeedLimits()


@dataclass(frozen=True, eq=False)
class Timed:
    """Knots of a motion: rad, rad/s, rad/s^2, each [len(time_s)][joints]. Quintic Hermite in between."""

    space: Literal["joint", "task"]
    time_s: Array
    positions: Array
    velocities: Array
    accelerations: Array

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1])

    @cached_property
    def _curve(self) -> quintic.Hermite:
        return quintic.Hermite(self.time_s, self.positions, self.velocities, self.accelerations)

    def at(self, times_s: Array) -> Array:
        """[times][3][joints]: positions, velocities, accelerations."""
        return self._curve.at(times_s)

    def sampled(self) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations at many times: the knots, or more if they are ends of pieces."""
        if len(self.time_s) > PIECES + 1:
            return self.positions, self.velocities, self.accelerations
        found = self.at(quintic.fine_times(self.time_s, max(KNOT_S, self.duration_s / SAMPLED)))
        return found[:, 0], found[:, 1], found[:, 2]

    def trajectory(self) -> JointTrajectory:
        return JointTrajectory(
            space=self.space,
            time_s=self.time_s.tolist(),
            positions=_knots(self.positions),
            velocities=_knots(self.velocities),
            accelerations=_knots(self.accelerations),
        )


def _knots(rows: Array) -> Knots:
    return Knots(rows.astype("<f8", copy=False).tobytes()).in_rows(len(rows))


def time_path(arm: ArmModel, path: Path, pace: SpeedLimits = NO_SPEED_LIMITS, load: Load | None = None) -> Timed:
    """Time the path. A path of zero length becomes a hold of one knot spacing.

    `load`: in the hand. Raises Refused if the arm cannot hold it against gravity everywhere on the path.
    """
    if path.is_a_point:
        return _zero_length(path)
    torques = Torques.of(arm, load)
    curved = isinstance(path.curve, Blended) or (path.space == "joint" and path.curve is not None)
    timed = _time_curve(arm, path, pace) if curved else _time_line(arm, path, pace)
    excess = torques.excess(timed.sampled)
    if excess <= 1.0:
        return timed
    # Too heavy for this acceleration: plan it within the torques; what remains between the samples slows all of it.
    timed = _time_curve(arm, path, pace, torques) if curved else _time_line(arm, path, pace, 1 / excess)
    excess = torques.excess(timed.sampled)
    return slower(timed, math.sqrt(max(1.0, excess)))


def _time_line(arm: ArmModel, path: Path, pace: SpeedLimits, share: float = 1.0) -> Timed:
    """`share`: of the acceleration that the other limits allow."""
    q, slope, bend = path.at(even(0.0, path.length, _samples(path) - 1))
    rate = 1.0 if path.space == "task" else float(arm.tcp_speeds(q, slope).max())
    velocity, acceleration = arm.limits.velocity * pace.ratio, arm.limits.acceleration * pace.ratio
    slope, bend = np.abs(slope) + 1e-12, np.abs(bend) + 1e-12
    # Up to half of a joint's acceleration serves the curvature at full pace; the rest serves changes of pace.
    pace_limit = min(
        pace.speed_m_s / max(rate, 1e-9),
        float((velocity / slope).min()),
        float(np.sqrt(acceleration / (2 * bend)).min()),
    )
    change_limit = share * min(
        pace.acceleration_m_s2 / max(rate, 1e-9), float(((acceleration - bend * pace_limit**2) / slope).min())
    )
    profile = rest_to_rest(path.length, pace_limit, change_limit, change_limit / RAMP_S)
    exact = path.space == "joint"  # the polynomials are the profile, which is within the limits everywhere
    if exact:
        time_s = profile.knots_s
    else:
        step_s = KNOT_M / pace.speed_m_s if len(path.s) <= SAMPLES else path.length / len(path.s) / pace_limit
        time_s = _knot_times(profile.duration_s, pace_limit / change_limit + RAMP_S, step_s)
    along, along_v, along_a = profile.at(time_s)
    q, slope, bend = path.at(along)
    accelerations = bend * along_v[:, None] ** 2 + slope * along_a[:, None]
    timed = _at_rest(Timed(path.space, time_s, q, slope * along_v[:, None], accelerations), path)
    return timed if exact else slowed(arm, timed)


def _samples(path: Path) -> int:
    """The number of points of a line at which limits are evaluated."""
    if path.curve is None:
        return min(SAMPLES, math.ceil(float(np.abs(path.knots[-1] - path.knots[0]).max()) / SAMPLE_RAD) + LEAST_SAMPLES)
    return SAMPLES if len(path.s) <= SAMPLES else 2 * len(path.s)  # a search pattern bends at every knot


def _time_curve(arm: ArmModel, path: Path, pace: SpeedLimits, torques: Torques | None = None) -> Timed:
    """With `torques` within them too: then toppra finds the pace, from the same limits on the same grid."""
    samples, grid = even(0.0, path.length, SAMPLES - 1), _grid(path)
    q, slope, _ = path.at(samples)
    rates = np.interp(grid, samples, arm.tcp_speeds(q, slope))
    levers = np.linalg.norm([arm.jacobian(row)[:3] for row in q[::4]], axis=1).max(axis=0)
    acceleration = np.minimum(arm.limits.acceleration * pace.ratio, pace.acceleration_m_s2 / np.maximum(levers, 0.05))
    _, slope, bend = path.at(grid)
    by_joints = (arm.limits.velocity * pace.ratio / np.maximum(np.abs(slope), STILL)).min(axis=1)
    most = np.minimum(by_joints, BETWEEN * pace.speed_m_s / np.maximum(rates, 1e-6))
    if torques is None:
        along_v = fastest(grid, slope, bend, most, acceleration)
    else:
        from workers.planning.motion.within_torques import fastest_within  # its import is long, and few need it

        along_v = fastest_within(torques, path, grid, most, acceleration)
    at_s = np.concatenate(((0.0,), np.cumsum(2 * np.diff(grid) / (along_v[1:] + along_v[:-1]))))
    time_s = _knot_times(float(at_s[-1]), CURVE_RAMP_S, KNOT_M / pace.speed_m_s)
    # The change of the pace leaps at the points of the grid; that of a spline through them does not.
    along = Spline(at_s, grid[:, None], at_rest=True)
    s, speed, change = along.at(time_s)
    q, slope, bend = path.at(s[:, 0])
    timed = _at_rest(Timed(path.space, time_s, q, slope * speed, bend * speed**2 + slope * change), path)
    # In a narrow corner the tcp may be faster than at the points of the grid.
    fastest_m_s = float(arm.tcp_speeds(q[::2], timed.velocities[::2]).max())
    return slowed(arm, slower(timed, max(1.0, fastest_m_s / (TOLERANCE * pace.speed_m_s))))


def _grid(path: Path) -> Array:
    """Grid points of the curve solver: evenly spaced, and closer within narrow corners."""
    even_points = even(0.0, path.length, GRID - 1)
    if not isinstance(path.curve, Blended):
        return even_points
    edges = path.curve.edges
    inside = np.linspace(edges[:-1], edges[1:], CORNER_GRID, endpoint=False).ravel()
    grid = np.union1d(even_points, np.append(inside, edges[-1]))
    return grid[np.concatenate(((True,), np.diff(grid) > GRID_STEP * path.length))]


def _knot_times(duration_s: float, ramp_s: float, step_s: float) -> Array:
    """Knot times: dense in both ramps, where the pace changes, and some `step_s` apart in between."""
    ramp_s = min(ramp_s, 0.5 * duration_s)
    n = max(2, math.ceil(ramp_s / KNOT_S))
    cruise_s = duration_s - 2 * ramp_s
    m = math.ceil(cruise_s / max(KNOT_S, step_s) - 1e-9)
    ramp_up, ramp_down = even(0.0, ramp_s, n), even(duration_s - ramp_s, duration_s, n)
    cruise = even(ramp_s, duration_s - ramp_s, m)[1:] if m > 0 else ()
    return np.concatenate((ramp_up, cruise, ramp_down[1:]))


def _at_rest(timed: Timed, path: Path) -> Timed:
    """Remove rounding errors at both ends: exact positions and zero velocity."""
    timed.positions[0], timed.positions[-1] = path.knots[0], path.knots[-1]
    timed.velocities[[0, -1]] = 0.0
    return timed


def slowed(arm: ArmModel, timed: Timed) -> Timed:
    """The motion slowed to satisfy the arm's limits between the knots too; the arm refuses violations."""
    points = quintic.control_points(timed.time_s, timed.positions, timed.velocities, timed.accelerations)
    faster = quintic.most_beyond(points.velocities, arm.limits.velocity)
    harder = quintic.most_beyond(points.accelerations, arm.limits.acceleration)
    return slower(timed, max(1.0, faster, math.sqrt(harder)))


def slower(timed: Timed, by: float) -> Timed:
    """The motion on the same path in `by` times the time."""
    if by == 1.0:
        return timed
    return Timed(
        timed.space, timed.time_s * by, timed.positions, timed.velocities / by, timed.accelerations / (by * by)
    )


def _zero_length(path: Path) -> Timed:
    still = np.zeros((2, path.knots.shape[1]))
    return Timed(path.space, np.array((0.0, KNOT_S)), np.tile(path.knots[-1], (2, 1)), still, still)
