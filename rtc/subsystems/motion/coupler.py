"""The coupler at the end of an arm, in one primitive: it locks a hand or lets go of one, once, after a time. Pure.

A halt before that leaves everything as it was; after it the arm has the hand, and its next report says so.
"""

from __future__ import annotations

from rtc.subsystems.motion.goals import LOCKS_S
from rtc.subsystems.motion.observation import Observation


class Coupler:
    def __init__(self, hand: str, seen: Observation) -> None:
        self._hand, self._seen = hand, seen
        self._worked = False
        self.why_not = ""  # why it has not locked

    def works(self, time_s: float) -> bool:
        """Whether it locks or lets go in this tick."""
        if self._worked or time_s < LOCKS_S:
            return False
        self._worked = True
        self.why_not = self._seen.arm.couple(self._hand)
        self._seen.refit()
        return True
