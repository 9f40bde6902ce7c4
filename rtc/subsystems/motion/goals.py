"""When a primitive has reached its goal: one test per kind of trajectory. Pure.

A test sees the observation of this tick and the time of the profile. The joints must rest at the goal, or lean on
something near it; a hand must have its opening, or its force. This module must not know states or stop functions.
"""

from __future__ import annotations

from collections.abc import Callable

from rtc.protocol import primitive as p
from rtc.spatial import geometry
from rtc.subsystems.motion.moment import Finding
from rtc.subsystems.motion.observation import Observation
from rtc.subsystems.motion.stop_functions import RELAXED_S

GOAL_RAD = 0.002  # maximum joint error at the goal
# An arm at rest for this long, this near the goal, leans on something and ends there; the report has its position. A
# stretched spring of 100 to 200 N/m at a wall must not count as the goal, and does from 0.06 rad on. The friction of a
# hinge of 1.5 N.m turns a joint of the wrist by 0.042 rad: a step that expects a load says in metres how far it may
# stretch the spring (`GoalReached.within_m`).
LEANING_TICKS, LEANING_RAD = 100, 0.04
WIDTH_M = 0.0005  # maximum error of the hand opening at the goal
# Shares of the commanded force. At the first a grip is complete at once. A hand may exert less than that: one
# that has stopped to press harder has gripped from the second on. Hands at rest on a bar press with 0.90 to 1.00 if
# they exert 0.9 or all of it, on nothing with 0.00 (docs/physics.md). The third is of the finger that presses less:
# 0.79 on a bar that is 2 mm aside, 0.02 if the other one alone meets a wall.
PRESSED, STEADY, BOTH = 0.95, 0.6, 0.5
# It has stopped if the force has changed by less than this share over this time. A hand at work adds 5 % in 0.01 s.
CHANGED, STEADY_S = 0.02, 0.1
LOCKS_S = 0.2  # from the order to a coupler until it has locked or let go
TURNED_RAD = 1e-6  # tolerance of the turn of a spindle

Arrived = Callable[[float], Finding | None]  # time of the profile (s) -> (measured, limit, '') at the goal


def arrival(
    trajectory: p.Trajectory,
    seen: Observation,
    duration_s: float,
    turned: Callable[[], float],
    within_m: float | None = None,
) -> Arrived:
    """The test of a trajectory. `duration_s`: of its profile; `turned`: what the spindle has turned (rad); `within_m`:
    see `GoalReached`."""
    if isinstance(trajectory, p.HandMotion):
        return _Hand(trajectory, seen)
    if isinstance(trajectory, p.SpindleMotion):
        wanted = abs(trajectory.turn_rad) - TURNED_RAD
        return lambda time_s: (done, wanted, "") if (done := abs(turned())) >= wanted else None
    if isinstance(trajectory, p.HoldStill):
        hold_s = trajectory.duration_s
        return lambda time_s: None if hold_s is None or time_s < hold_s else (time_s, hold_s, "")
    if isinstance(trajectory, p.Coupling):
        return lambda time_s: (time_s, LOCKS_S, "") if time_s >= LOCKS_S and seen.fingers_rest() else None
    if isinstance(trajectory, p.TeleopMotion):
        return lambda time_s: None  # the operator states it
    assert isinstance(trajectory, p.JointTrajectory)
    return _Path(trajectory, seen, duration_s, within_m)


class _Path:
    """The end of a path."""

    def __init__(
        self, trajectory: p.JointTrajectory, seen: Observation, duration_s: float, within_m: float | None
    ) -> None:
        self._goal, self._seen, self._duration_s = trajectory.positions[-1], seen, duration_s
        self._within_m = within_m
        self._leaning_ticks = 0

    def __call__(self, time_s: float) -> Finding | None:
        if time_s < self._duration_s:
            return None
        error, rests = self._seen.off(self._goal), self._seen.joints_rest()
        self._leaning_ticks = self._leaning_ticks + 1 if rests else 0
        if rests and error <= GOAL_RAD:
            return error, GOAL_RAD, ""
        if self._leaning_ticks < LEANING_TICKS:
            return None
        if error <= LEANING_RAD:
            return error, LEANING_RAD, ""
        return self._stretched()

    def _stretched(self) -> Finding | None:
        """A compliant arm whose spring a load stretches, by no more than the step allows."""
        within_m = self._within_m
        if within_m is None:
            return None
        off_m = geometry.distance(self._seen.tcp(), self._seen.arm.tcp_pose(self._goal))
        return (off_m, within_m, "") if off_m <= within_m else None


class _Hand:
    """The end of a motion of the fingers: at their width, or with a grip."""

    def __init__(self, trajectory: p.HandMotion, seen: Observation) -> None:
        self._width_m, self._force_n, self._seen = trajectory.width_m, trajectory.force_n, seen
        self._level_n, self._since_s = 0.0, 0.0  # the force that has not changed since then

    def __call__(self, time_s: float) -> Finding | None:
        seen, force_n = self._seen, self._force_n
        # On an object off the centre of the hand one finger presses more and the other less by the same amount.
        pressed = 0.5 * sum(seen.sample.finger_forces)
        if abs(pressed - self._level_n) > CHANGED * force_n:
            self._level_n, self._since_s = pressed, time_s
        if not seen.fingers_rest():
            return None
        error = abs(seen.width_m - self._width_m)
        if error <= WIDTH_M:
            return error, WIDTH_M, ""
        if time_s < RELAXED_S and PRESSED * pressed > force_n:
            return None  # an earlier command has closed it more strongly
        share = STEADY if time_s - self._since_s >= STEADY_S else PRESSED
        closing = seen.width_m > self._width_m
        if closing and pressed >= share * force_n and seen.grip_n >= BOTH * force_n:
            return pressed, force_n, ""
        return None
