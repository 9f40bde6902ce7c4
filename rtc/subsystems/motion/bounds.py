"""One quick test that excludes all stop functions of a primitive in a tick in which none is near. Pure.

It uses bounds that are safe and cheap: a norm instead of each part, and the distance that the joints may still turn
before one of them can be near its limit. If it fails, the stop functions themselves decide. A primitive with a
condition that has no such bound never passes it. This module must not know states or reports.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from math import dist
from typing import Any

from rtc.protocol import primitive as p
from rtc.subsystems.motion.arm import Motion, Sample, Traits
from rtc.subsystems.motion.observation import Observation
from rtc.subsystems.motion.stop_functions import Stops


class ConditionBounds:
    """Values within which no condition is true. All comparisons are false for NaN."""

    def __init__(self, stops: Stops, traits: Traits) -> None:
        self.force_n = self.torque_nm = self.time_s = self.speed_rad_s = self.off_rad = self.grip_most_n = math.inf
        self.grip_n = self.width_m = -math.inf
        self.exist = True
        self._still = [0.0] * len(traits.velocity)
        self._lower, self._upper = traits.lower, traits.upper
        self._margin_rad = -math.inf
        self._safe, self._safe_rad = traits.lower, 0.0  # joints of a tick, and their distance to the nearest limit
        for stop, _ in stops:
            if (lower := LOWER.get(type(stop.when))) is None:
                self.exist = False
            else:
                lower(self, stop.when, traits)
        self._hand = self.grip_n > -math.inf or self.width_m > -math.inf or self.grip_most_n < math.inf

    def hold(self, seen: Observation, command: Motion) -> bool:
        """Whether no condition is true in this tick; False means unknown. Goal and time are not tested."""
        sample = seen.sample
        joints = sample.joints
        return (
            self.exist
            and seen.force_n <= self.force_n
            and seen.torque_nm <= self.torque_nm
            and dist(sample.velocities, self._still) <= self.speed_rad_s
            and dist(joints, command[0]) <= self.off_rad
            and (dist(joints, self._safe) < self._safe_rad or self._is_far(joints))
            and (not self._hand or self._holds(sample))
            and seen.arm.untouched()
        )

    def _holds(self, sample: Sample) -> bool:
        """Whether the hand has what it had."""
        least_n, most_n = min(sample.finger_forces), max(sample.finger_forces)
        return self.grip_n <= least_n and most_n <= self.grip_most_n and self.width_m <= sum(sample.fingers)

    def _is_far(self, joints: list[float]) -> bool:
        """Whether no joint is near its limit; notes how far they may turn."""
        rows = zip(joints, self._lower, self._upper, strict=True)
        self._safe = list(joints)
        self._safe_rad = min(min(q - low, high - q) for q, low, high in rows) - self._margin_rad
        return self._safe_rad > 0.0

    # --- by condition ------------------------------------------------------------------------------------

    def _force(self, when: p.ForceAbove, traits: Traits) -> None:
        self.force_n = min(self.force_n, _along(when.limit_n, when.axis))

    def _torque(self, when: p.TorqueAbove, traits: Traits) -> None:
        self.torque_nm = min(self.torque_nm, _along(when.limit_nm, when.axis))

    def _time(self, when: p.TimeAbove, traits: Traits) -> None:
        self.time_s = min(self.time_s, when.limit_s)

    def _speed(self, when: p.SpeedAbove, traits: Traits) -> None:
        self.speed_rad_s = min(self.speed_rad_s, *(when.ratio * limit for limit in traits.velocity))

    def _following(self, when: p.FollowingErrorAbove, traits: Traits) -> None:
        self.off_rad = min(self.off_rad, when.limit_rad)

    def _margin(self, when: p.JointMarginBelow, traits: Traits) -> None:
        self._margin_rad = max(self._margin_rad, when.margin_rad)

    def _grip(self, when: p.GripForceBelow, traits: Traits) -> None:
        self.grip_n = max(self.grip_n, when.limit_n)
        self.exist &= not when.once_above  # it remembers

    def _width(self, when: p.HandWidthBelow, traits: Traits) -> None:
        self.width_m = max(self.width_m, when.limit_m)

    def _grip_above(self, when: p.GripForceAbove, traits: Traits) -> None:
        self.grip_most_n = min(self.grip_most_n, when.limit_n)


def _along(limit: float, axis: list[float] | None) -> float:
    """The magnitude below which no part along the axis exceeds the limit."""
    length = 1.0 if axis is None else math.hypot(*axis)
    return limit / length if length else math.inf if limit >= 0.0 else -math.inf


LOWER: dict[type, Callable[[ConditionBounds, Any, Traits], None]] = {
    p.GoalReached: lambda bounds, when, traits: None,
    p.BodyTouch: lambda bounds, when, traits: None,
    p.ArmTouch: lambda bounds, when, traits: None,
    p.ForceAbove: ConditionBounds._force,
    p.TorqueAbove: ConditionBounds._torque,
    p.TimeAbove: ConditionBounds._time,
    p.SpeedAbove: ConditionBounds._speed,
    p.FollowingErrorAbove: ConditionBounds._following,
    p.JointMarginBelow: ConditionBounds._margin,
    p.GripForceBelow: ConditionBounds._grip,
    p.HandWidthBelow: ConditionBounds._width,
    p.GripForceAbove: ConditionBounds._grip_above,
}
