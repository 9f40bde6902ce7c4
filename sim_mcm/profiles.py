"""Commanded motion over time: following knots, stopping, retracing, staying.

A profile is a function of its own time (s, from 0) that gives joints, velocities, accelerations; the caller owns the
clock. Every profile takes over from wherever the command is and is smooth from there on, so that no command ever
jumps. Ruckig is used from state to state only. This file knows no arm, no sample and no reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import ruckig

from rtc.geometry import Array
from rtc.primitive import JointTrajectory
from sim_mcm.arm import TICK_S, Motion

# How hard a stop brakes: from 0.25 m/s in about 60 ms, with the torques well inside the motors'. The jerk is high, so
# that a slow guarded move stands within 3 ms and does not lean on what it has found.
STOP_ACCELERATION_RAD_S2 = 12.0
STOP_JERK_RAD_S3 = 20_000.0
# With something in the hand: a harder stop turns two kilograms, 150 mm before the fingers, out of their grip.
LADEN_ACCELERATION_RAD_S2 = 4.0
LADEN_JERK_RAD_S3 = 400.0
# How softly the command goes to where contact has stopped the arm, so that it presses no more.
YIELD_VELOCITY_RAD_S, YIELD_ACCELERATION_RAD_S2, YIELD_JERK_RAD_S3 = 0.2, 2.0, 200.0
BLOCK = 64  # ticks of a path that are worked out at once
BLEND_S = 0.25  # over which a small difference between command and path is worked off
RETREAT_SPEED_M_S = 0.05  # of the tcp, at most, in a reflex
RETREAT_LEAST_S = 0.2


class Profile(Protocol):
    duration_s: float  # after it, `at` stays at the end

    def at(self, time_s: float) -> Motion: ...


class Stay:
    """No motion."""

    duration_s = 0.0

    def __init__(self, joints: Sequence[float]) -> None:
        still = [0.0] * len(joints)
        self._motion: Motion = (list(joints), still, still)

    def at(self, time_s: float) -> Motion:
        return self._motion


class Follow:
    """Quintic Hermite polynomials through the knots, taken up from `start`, which may differ a little from the first
    of them. Worked out for BLOCK ticks at once, which costs a tenth of doing it for each."""

    def __init__(self, trajectory: JointTrajectory, start: Sequence[float]) -> None:
        self._length_s = trajectory.duration_s
        self._knots_s = np.asarray(trajectory.time_s)
        self._pieces = _hermite(trajectory)
        self._offset = np.asarray(start) - np.asarray(trajectory.positions[0])
        self._blend = bool(np.abs(self._offset).max() > 1e-9)
        self.duration_s = max(self._length_s, BLEND_S) if self._blend else self._length_s
        self._end = Stay(trajectory.positions[-1]).at(0.0)
        self._block: list[list[list[float]]] = []  # of the ticks from _first on
        self._first = 0

    def at(self, time_s: float) -> Motion:
        if time_s >= self.duration_s:
            return self._end
        n = round(time_s / TICK_S) - self._first
        if not 0 <= n < len(self._block):
            self._first += n
            n = 0
            times_s: Array = (self._first + np.arange(BLOCK, dtype=np.float64)) * TICK_S
            block = self.path(times_s)
            if self._blend and times_s[0] < BLEND_S:
                block += self._worked_off(times_s)
            self._block = block.tolist()
        joints, velocities, accelerations = self._block[n]
        return joints, velocities, accelerations

    def path(self, times_s: Array) -> Array:
        """k x 3 x n: joints, velocities, accelerations of the path itself at k times."""
        t = np.clip(times_s, 0.0, self._length_s)
        piece = np.clip(np.searchsorted(self._knots_s, t, side="right") - 1, 0, len(self._pieces) - 1)
        u = (t - self._knots_s[piece])[:, None] ** np.arange(6)  # its powers
        coefficients = self._pieces[piece]  # k x 6 x n
        motion = np.empty((len(t), 3, coefficients.shape[2]))
        for order, derivative in enumerate(DERIVATIVES):
            factors, powers = derivative
            motion[:, order] = np.einsum("kp,kpn->kn", u[:, powers] * factors, coefficients[:, order:])
        return motion

    def _worked_off(self, times_s: Array) -> Array:
        """What is left of the difference at the start."""
        rows = []
        for t in times_s.tolist():
            fade, slope, bend = _smooth(t / BLEND_S)
            rows.append((1.0 - fade, -slope / BLEND_S, -bend / BLEND_S**2))
        return np.asarray(rows)[:, :, None] * self._offset


# Of a polynomial's terms: the factors and the powers of u that the value, slope and second derivative take.
DERIVATIVES: tuple[tuple[Array, list[int]], ...] = (
    (np.ones(6), [0, 1, 2, 3, 4, 5]),
    (np.array((1.0, 2.0, 3.0, 4.0, 5.0)), [0, 1, 2, 3, 4]),
    (np.array((2.0, 6.0, 12.0, 20.0)), [0, 1, 2, 3]),
)


class Brake:
    """From any state of motion to rest, straight on, with limited acceleration and jerk."""

    def __init__(self, now: Motion, *, laden: bool = False) -> None:
        limits = (
            (LADEN_ACCELERATION_RAD_S2, LADEN_JERK_RAD_S3) if laden else (STOP_ACCELERATION_RAD_S2, STOP_JERK_RAD_S3)
        )
        wanted = _state(now, *limits)
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.synchronization = ruckig.Synchronization.Phase  # all joints together: the tcp keeps its line
        wanted.target_velocity = [0.0] * len(now[0])
        self._way = _solve(wanted)
        self.duration_s: float = self._way.duration

    def at(self, time_s: float) -> Motion:
        return _rest_after(self._way, time_s)


class Yield:
    """From rest to the joints that contact has left the arm with: the command no longer leans on the thing."""

    def __init__(self, now: Motion, measured: Sequence[float]) -> None:
        wanted = _state(now, YIELD_ACCELERATION_RAD_S2, YIELD_JERK_RAD_S3)
        wanted.max_velocity = [YIELD_VELOCITY_RAD_S] * len(now[0])
        wanted.target_position = list(measured)
        self._way = _solve(wanted)
        self.duration_s: float = self._way.duration

    def at(self, time_s: float) -> Motion:
        return _rest_after(self._way, time_s)


class Retrace:
    """Back along the way it came, `back_m` of the tcp's path (or to the start of it), from `start` at rest."""

    def __init__(
        self,
        came: Follow,
        tripped_s: float,
        start: Sequence[float],
        back_m: float,
        tcp: Callable[[Sequence[float]], Array],
    ) -> None:
        self._came = came
        self._from_s = min(tripped_s, came.duration_s)
        self._to_s, length_m = _time_before(came, self._from_s, back_m, tcp)
        span_s = self._from_s - self._to_s
        # 1.875 is the greatest slope of the smooth step: with it the way back is nowhere quicker than the way there.
        self.duration_s = max(1.875 * span_s, 1.875 * length_m / RETREAT_SPEED_M_S, RETREAT_LEAST_S)
        self._offset = np.asarray(start) - came.path(np.array([self._from_s]))[0, 0]
        self._end = Stay(came.path(np.array([self._to_s]))[0, 0].tolist()).at(0.0)

    def at(self, time_s: float) -> Motion:
        if time_s >= self.duration_s:
            return self._end
        span_s = self._to_s - self._from_s
        fade, slope, bend = _smooth(time_s / self.duration_s)
        rate, change = span_s * slope / self.duration_s, span_s * bend / self.duration_s**2
        q, qd, qdd = self._came.path(np.array([self._from_s + span_s * fade]))[0]
        d = self.duration_s
        return (
            (q + (1.0 - fade) * self._offset).tolist(),
            (qd * rate - slope / d * self._offset).tolist(),
            (qdd * rate**2 + qd * change - bend / d**2 * self._offset).tolist(),
        )


def _smooth(x: float) -> tuple[float, float, float]:
    """The quintic step from 0 to 1 that begins and ends at rest: value, slope, second derivative."""
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10 + x * (6 * x - 15)), 30 * (x * (x - 1)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _hermite(trajectory: JointTrajectory) -> Array:
    """Per piece the 6 x n coefficients of the quintic with both knots' position, velocity and acceleration."""
    q, v, a = (np.asarray(rows) for rows in (trajectory.positions, trajectory.velocities, trajectory.accelerations))
    pieces = []
    for k, (begin_s, end_s) in enumerate(zip(trajectory.time_s, trajectory.time_s[1:], strict=False)):
        t = end_s - begin_s
        dq = q[k + 1] - q[k] - v[k] * t - 0.5 * a[k] * t * t
        dv = v[k + 1] - v[k] - a[k] * t
        da = a[k + 1] - a[k]
        pieces.append(
            np.stack(
                (
                    q[k],
                    v[k],
                    0.5 * a[k],
                    (10 * dq - 4 * dv * t + 0.5 * da * t * t) / t**3,
                    (-15 * dq + 7 * dv * t - da * t * t) / t**4,
                    (6 * dq - 3 * dv * t + 0.5 * da * t * t) / t**5,
                )
            )
        )
    return np.stack(pieces)


def _state(now: Motion, acceleration: float, jerk: float) -> ruckig.InputParameter:
    joints, velocities, accelerations = now
    wanted = ruckig.InputParameter(len(joints))
    wanted.current_position, wanted.current_velocity = list(joints), list(velocities)
    wanted.current_acceleration = list(accelerations)
    wanted.target_velocity = [0.0] * len(joints)
    wanted.max_velocity = [10.0] * len(joints)  # of no effect while braking
    # A path may accelerate harder than we brake: then that is the limit, for ruckig takes no state beyond it.
    wanted.max_acceleration = [max(acceleration, abs(a)) for a in accelerations]
    wanted.max_jerk = [jerk] * len(joints)
    return wanted


def _solve(wanted: ruckig.InputParameter) -> ruckig.Trajectory:
    """A stop must always be found. Ruckig's solver loses rare states to rounding; other limits, a per mille harder, or
    joints that stop each in its own time, are found instead."""
    dof = wanted.degrees_of_freedom
    for harder in (1.0, 1.001, 1.003, 1.01, 1.03, 1.1):
        wanted.max_acceleration = [a * harder for a in wanted.max_acceleration]
        wanted.max_jerk = [j * harder for j in wanted.max_jerk]
        for synchronization in (wanted.synchronization, ruckig.Synchronization.No):
            wanted.synchronization = synchronization
            way = ruckig.Trajectory(dof)
            try:
                result = ruckig.Ruckig(dof).calculate(wanted, way)
            except ruckig.RuckigError:
                continue
            if result in (ruckig.Result.Working, ruckig.Result.Finished):
                return way
    raise AssertionError(f"ruckig finds no way to rest from {wanted}")


def _rest_after(way: ruckig.Trajectory, time_s: float) -> Motion:
    if time_s >= way.duration:
        joints, _, _ = way.at_time(way.duration)
        return Stay(joints).at(0.0)
    motion: Motion = way.at_time(time_s)
    return motion


def _time_before(
    came: Follow, from_s: float, back_m: float, tcp: Callable[[Sequence[float]], Array], steps: int = 100
) -> tuple[float, float]:
    """The moment at which the tcp had `back_m` less of its path behind it, and the length really found (m)."""
    if back_m <= 0.0:
        return from_s, 0.0
    times_s = np.linspace(from_s, 0.0, steps + 1)
    joints = came.path(times_s)[:, 0]
    length_m, later_s = 0.0, from_s
    later = tcp(joints[0])[:3]
    for earlier_s, q in zip(times_s[1:].tolist(), joints[1:], strict=True):
        earlier = tcp(q)[:3]
        piece_m = float(np.linalg.norm(later - earlier))
        if length_m + piece_m >= back_m:
            share = (back_m - length_m) / piece_m
            return later_s + share * (earlier_s - later_s), back_m
        length_m, later_s, later = length_m + piece_m, earlier_s, earlier
    return 0.0, length_m
