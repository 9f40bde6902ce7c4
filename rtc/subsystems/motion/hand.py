"""The commands of a hand, and what it does when it is stopped. Pure."""

from __future__ import annotations

from rtc.protocol.primitive import HandMotion
from rtc.subsystems.motion.arm import HandCommand
from rtc.subsystems.motion.goals import WIDTH_M
from rtc.subsystems.motion.observation import Observation

SQUEEZE_N = 1.0  # a smaller finger force does not count as a grip


class Hand:
    def __init__(self, seen: Observation) -> None:
        traits = seen.arm.traits
        self._seen = seen
        self.command = HandCommand(seen.width_m, traits.max_grip_n, traits.hand_speed_m_s)  # the latest

    @property
    def grips(self) -> bool:
        return self._seen.grip_n > SQUEEZE_N

    def move(self, motion: HandMotion) -> None:
        self._use(HandCommand(motion.width_m, motion.force_n, motion.speed_m_s))

    def open(self) -> None:
        traits = self._seen.arm.traits
        self._use(HandCommand(traits.max_opening_m, traits.max_grip_n, traits.hand_speed_m_s))

    @property
    def is_open(self) -> bool:
        return self._seen.width_m >= self._seen.arm.traits.max_opening_m - WIDTH_M

    def freeze(self) -> None:
        """Stop the fingers. A hand that grips keeps its present force."""
        pressed, hand = self._seen.grip_n, self.command
        if pressed < SQUEEZE_N:
            self._use(HandCommand(self._seen.width_m, hand.force_n, hand.speed_m_s))
        else:
            self._use(HandCommand(hand.width_m, min(pressed, hand.force_n), hand.speed_m_s))

    def _use(self, command: HandCommand) -> None:
        self.command = command
        self._seen.arm.command_hand(command)
