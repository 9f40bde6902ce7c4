"""The turn of the spindle of a held driver, over pauses. Pure.

A pause stops the spindle; afterwards it turns by what is left. This module must not know states or stop functions.
"""

from __future__ import annotations

from rtc.protocol.primitive import SpindleMotion
from rtc.subsystems.motion.arm import SpindleCommand
from rtc.subsystems.motion.goals import TURNED_RAD
from rtc.subsystems.motion.observation import Observation


class SpindleTurn:
    def __init__(self, motion: SpindleMotion, seen: Observation) -> None:
        self._motion, self._seen = motion, seen
        self._before_rad = 0.0  # turned before the latest pause
        self._turns = False

    def run(self) -> None:
        """Turn it by what is left. Raises ValueError if the hand holds no driver, or the driver cannot do it."""
        left = self._motion.turn_rad - self._before_rad
        if abs(left) > TURNED_RAD:
            self._seen.arm.drive_spindle(SpindleCommand(left, self._motion.speed_rad_s, self._motion.torque_nm))
            self._turns = True

    def stop(self) -> None:
        self._before_rad = self.turned_rad
        self._turns = False
        self._seen.arm.drive_spindle(None)

    @property
    def turned_rad(self) -> float:
        """By this motion so far."""
        return self._before_rad + (self._seen.arm.spindle().turned_rad if self._turns else 0.0)

    @property
    def done(self) -> float:
        """Share of the turn, 0 to 1."""
        return min(1.0, abs(self.turned_rad / self._motion.turn_rad)) if self._motion.turn_rad else 1.0
