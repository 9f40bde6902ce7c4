"""Motion profiles: commanded motion over time, for following knots, braking, unloading, retracing and staying.

A profile maps its own time (s, from 0) to joints, velocities and accelerations; the caller owns the clock. Every
profile starts from the present command and is smooth, so a command never jumps. Ruckig solves state-to-state motions
only. This module must not know arms, samples or stop reasons.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
import ruckig

from rtc.model.robot.quintic import Hermite
from rtc.protocol.primitive import JointTrajectory
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion

# Limits while braking: 0.25 m/s takes about 60 ms, with torques well below the motor limits. The jerk is high, so that
# a slow guarded move stops within 3 ms and does not press on the obstacle.
STOP_ACCELERATION_RAD_S2 = 12.0
STOP_JERK_RAD_S3 = 20_000.0
# With an object in the hand: harder braking turns two kilograms, 150 mm before the fingers, out of the grip.
LADEN_ACCELERATION_RAD_S2 = 4.0
LADEN_JERK_RAD_S3 = 400.0
# The command of an arm that leans on something goes to where the arm is: by this share of its lead per second, and not
# faster than this.
UNLOAD_PER_S, UNLOAD_RAD_S = 100.0, 0.2
MIN_LEAD_RAD = 5e-5  # it ends at this lead, some 3 N at the hand
UNLOAD_LIMIT_S = 2.0
UNLOAD_FAR_RAD = 0.05  # from where the arm was: a lead that comes from a weight does not end
TICKS_PER_S = 1.0 / TICK_S
BLOCK = 256  # number of ticks of a path computed at once
SAME_S = 1e-7  # rounding of a time that counts ticks
BLEND_S = 0.25  # in which an initial offset between command and path fades out ...
BLEND_RAD_S = 0.2  # ... or longer, at this maximum speed
BLEND_RAD_S2 = 0.5  # ... or sooner, if it is so small that this acceleration suffices
RETREAT_SPEED_M_S = 0.05  # maximum tcp speed in a reflex
RETREAT_MIN_S = 0.2


Number = TypeVar("Number", float, Array)


class Profile(Protocol):
    duration_s: float  # after this time `at` returns the end state

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
    """Quintic Hermite polynomials through the knots, from `start`, which may differ slightly from the first knot.
    Computed for BLOCK ticks at once: 0.2 us a tick instead of 30."""

    def __init__(
        self, trajectory: JointTrajectory, start: Sequence[float], most_rad_s: Sequence[float] | None = None
    ) -> None:
        self._most_rad_s = None if most_rad_s is None else np.asarray(most_rad_s)
        self.within_limits = (
            False  # from the motion before to the latest one: neither step nor speed exceeds the limits
        )
        self.block_fits = False  # the same of all motions of the block, but for the step to the first
        self._length_s = trajectory.duration_s
        self._curve = Hermite(trajectory.time_s, trajectory.positions, trajectory.velocities, trajectory.accelerations)
        self._offset = np.asarray(start) - np.asarray(trajectory.positions[0])
        most = float(np.abs(self._offset).max())
        soon_s = min(BLEND_S, math.sqrt(5.774 * most / BLEND_RAD_S2))
        self._blend_s = max(soon_s, 1.875 * most / BLEND_RAD_S) if most > 1e-9 else 0.0
        self.duration_s = max(self._length_s, self._blend_s)
        self._end = Stay(trajectory.positions[-1]).at(0.0)
        self.block: Array = np.empty((0, 3, 0))  # motions, one per tick
        self._first_s = 0.0  # time of the first
        self.latest = 0  # index of the latest

    def at(self, time_s: float) -> Motion:
        if time_s >= self.duration_s:
            self.within_limits = False
            return self._end
        since_s = time_s - self._first_s
        n = int(since_s * TICKS_PER_S + 0.5)
        if 0 <= n < len(self.block) and -SAME_S < since_s - n * TICK_S < SAME_S:
            self.within_limits = self.block_fits
        else:
            self._begin_block(time_s)
            self.within_limits, n = False, 0
        self.latest = n
        motion: Motion = self.block[n].tolist()
        return motion

    def _begin_block(self, time_s: float) -> None:
        """Compute the ticks from this time on."""
        times_s = time_s + BLOCK_S
        block = self.path(times_s)
        if time_s < self._blend_s:
            block += self._remaining_offset(times_s)
        self.block, self._first_s = block, time_s
        self.block_fits = self._fits(block)

    def _fits(self, block: Array) -> bool:
        if self._most_rad_s is None:
            return False
        steps, speeds = block[1:, 0] - block[:-1, 0], block[:, 1]
        return _within(steps, TICK_S * self._most_rad_s) and _within(speeds, self._most_rad_s)

    def path(self, times_s: Array) -> Array:
        """k x 3 x n: joints, velocities, accelerations of the path itself at k times."""
        return self._curve.at(times_s)

    def nearest_s(self, joints: Sequence[float], before_s: float, steps: int = 200) -> float:
        """The path time, at most `before_s`, at which the path is nearest to these joints (largest joint distance)."""
        times_s = np.linspace(0.0, min(before_s, self._length_s), steps + 1)
        distances = np.abs(self.path(times_s)[:, 0] - np.asarray(joints)).max(axis=1)
        return float(times_s[int(distances.argmin())])

    def _remaining_offset(self, times_s: Array) -> Array:
        """The remaining part of the initial offset."""
        fade, slope, bend = _quintic_step(np.clip(times_s / self._blend_s, 0.0, 1.0))
        rows = np.stack((1.0 - fade, -slope / self._blend_s, -bend / self._blend_s**2), axis=1)
        return rows[:, :, None] * self._offset


def _within(rows: Array, most: Array) -> bool:
    """Whether no value of any row exceeds that of its column in magnitude; false for NaN."""
    return bool((np.abs(rows) <= most).all())


BLOCK_S: Array = TICK_S * np.arange(BLOCK, dtype=np.float64)


class Brake:
    """From any motion state to rest along the same direction, with limited acceleration and jerk."""

    def __init__(self, motion: Motion, *, laden: bool = False) -> None:
        limits = (
            (LADEN_ACCELERATION_RAD_S2, LADEN_JERK_RAD_S3) if laden else (STOP_ACCELERATION_RAD_S2, STOP_JERK_RAD_S3)
        )
        wanted = _state(motion, *limits)
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.synchronization = ruckig.Synchronization.Phase  # joints synchronized, so the tcp keeps its line
        wanted.target_velocity = [0.0] * len(motion[0])
        self._solution = _solve(wanted)
        self.duration_s: float = self._solution.duration

    def at(self, time_s: float) -> Motion:
        return _rest_after(self._solution, time_s)


class Unload:
    """From rest, the command goes to where the arm is and moves with it, until the arm presses on nothing.

    To set the command to the measured joints once is not enough: an arm that leans on something springy, such as its
    own fingers, moves on when its command yields. Its speed commands the arm too, so the servo becomes a damper. Call
    `at` once per tick. `measured`: the present joints (rad)."""

    duration_s = UNLOAD_LIMIT_S  # at most

    def __init__(self, motion: Motion, measured: Callable[[], Sequence[float]]) -> None:
        self._joints, self._measured = list(motion[0]), measured
        self._speeds = self._still = [0.0] * len(self._joints)
        self._bounds = [(q - UNLOAD_FAR_RAD, q + UNLOAD_FAR_RAD) for q in measured()]
        self._done = False

    def done(self, time_s: float) -> bool:
        """Whether the command is where the arm is, or does not come nearer. Then `at` stays there."""
        if not self._done and self._lead_rad() <= MIN_LEAD_RAD:
            self._joints, self._done = list(self._measured()), True  # without a jump that can be felt
        self._done |= time_s >= self.duration_s
        return self._done

    def _lead_rad(self) -> float:
        return max(abs(wanted - q) for wanted, q in zip(self._joints, self._measured(), strict=True))

    def at(self, time_s: float) -> Motion:
        if self._done:
            return self._joints, self._still, self._still
        aims = (min(most, max(least, q)) for q, (least, most) in zip(self._measured(), self._bounds, strict=True))
        wanted = _within_most(
            [UNLOAD_PER_S * (aim - q) for aim, q in zip(aims, self._joints, strict=True)], UNLOAD_RAD_S
        )
        change = [new - old for new, old in zip(wanted, self._speeds, strict=True)]
        change = _within_most(change, STOP_ACCELERATION_RAD_S2 * TICK_S)
        speeds = [old + more for old, more in zip(self._speeds, change, strict=True)]
        self._joints = [q + TICK_S * speed for q, speed in zip(self._joints, speeds, strict=True)]
        self._speeds = speeds
        return self._joints, speeds, self._still


def _within_most(values: list[float], most: float) -> list[float]:
    """The same direction, with no component beyond `most`: if each joint were limited by itself, a light wrist would
    lag behind, and the hand would give way towards what it presses on."""
    greatest = max(map(abs, values))
    return values if greatest <= most else [most / greatest * value for value in values]


class Retrace:
    """Back along the followed path by `back_m` of tcp travel (at most to its start), from `start` at rest."""

    def __init__(
        self,
        followed: Follow,
        tripped_s: float,
        start: Sequence[float],
        back_m: float,
        tcp: Callable[[Sequence[float]], Array],
    ) -> None:
        self._followed = followed
        self._from_s = min(tripped_s, followed.duration_s)
        self._to_s, length_m = _time_before(followed, self._from_s, back_m, tcp)
        span_s = self._from_s - self._to_s
        # 1.875 is the greatest slope of the smooth step; with this factor the return is nowhere faster than the path.
        self.duration_s = max(1.875 * span_s, 1.875 * length_m / RETREAT_SPEED_M_S, RETREAT_MIN_S)
        self._offset = np.asarray(start) - followed.path(np.array([self._from_s]))[0, 0]
        self._end = Stay(followed.path(np.array([self._to_s]))[0, 0].tolist()).at(0.0)

    def at(self, time_s: float) -> Motion:
        if time_s >= self.duration_s:
            return self._end
        span_s = self._to_s - self._from_s
        fade, slope, bend = smooth(time_s / self.duration_s)
        rate, change = span_s * slope / self.duration_s, span_s * bend / self.duration_s**2
        q, qd, qdd = self._followed.path(np.array([self._from_s + span_s * fade]))[0]
        d = self.duration_s
        return (
            (q + (1.0 - fade) * self._offset).tolist(),
            (qd * rate - slope / d * self._offset).tolist(),
            (qdd * rate**2 + qd * change - bend / d**2 * self._offset).tolist(),
        )


def smooth(x: float) -> tuple[float, float, float]:
    """Quintic step from 0 to 1 with rest at both ends: value, slope, second derivative."""
    return _quintic_step(min(max(x, 0.0), 1.0))


def _quintic_step(x: Number) -> tuple[Number, Number, Number]:
    return x**3 * (10 + x * (6 * x - 15)), 30 * (x * (x - 1)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


def _state(motion: Motion, acceleration: float, jerk: float) -> ruckig.InputParameter:
    joints, velocities, accelerations = motion
    wanted = ruckig.InputParameter(len(joints))
    wanted.current_position, wanted.current_velocity = list(joints), list(velocities)
    wanted.current_acceleration = list(accelerations)
    wanted.target_velocity = [0.0] * len(joints)
    wanted.max_velocity = [10.0] * len(joints)  # without effect while braking
    # A path may accelerate harder than these limits. Then its acceleration is the limit: ruckig rejects states above
    # it.
    wanted.max_acceleration = [max(acceleration, abs(a)) for a in accelerations]
    wanted.max_jerk = [jerk] * len(joints)
    return wanted


def _solve(wanted: ruckig.InputParameter) -> ruckig.Trajectory:
    """Solve, retrying until a stop is found. Rounding makes ruckig fail for rare states; slightly higher limits, or
    joints without synchronization, then succeed."""
    dof = wanted.degrees_of_freedom
    for harder in (1.0, 1.001, 1.003, 1.01, 1.03, 1.1):
        wanted.max_acceleration = [a * harder for a in wanted.max_acceleration]
        wanted.max_jerk = [j * harder for j in wanted.max_jerk]
        for synchronization in (wanted.synchronization, ruckig.Synchronization.No):
            wanted.synchronization = synchronization
            solution = ruckig.Trajectory(dof)
            try:
                result = ruckig.Ruckig(dof).calculate(wanted, solution)
            except ruckig.RuckigError:
                continue
            if result in (ruckig.Result.Working, ruckig.Result.Finished):
                return solution
    raise AssertionError(f"ruckig found no trajectory to rest from {wanted}")


def _rest_after(solution: ruckig.Trajectory, time_s: float) -> Motion:
    if time_s >= solution.duration:
        joints, _, _ = solution.at_time(solution.duration)
        return Stay(joints).at(0.0)
    motion: Motion = solution.at_time(time_s)
    return motion


def _time_before(
    followed: Follow, from_s: float, back_m: float, tcp: Callable[[Sequence[float]], Array], steps: int = 100
) -> tuple[float, float]:
    """(path time (s) at which the tcp is `back_m` before its position at `from_s`, length found (m))."""
    if back_m <= 0.0:
        return from_s, 0.0
    times_s = np.linspace(from_s, 0.0, steps + 1)
    joints = followed.path(times_s)[:, 0]
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
