"""The servo of a parallel hand: finger forces from opening, speed and the command. Pure; one tick at a time.

The setpoint of the opening moves to the commanded width at the commanded speed. A virtual spring, limited to the
commanded force, pulls the fingers towards it. With an object between the fingers the spring stretches until that force
is reached, and then holds it. A second spring keeps the fingers in the middle of the hand, so it centres the hand over
the object (measured values: docs/physics.md).
"""

from __future__ import annotations

from sim_mcm.arms.arm import TICK_S, HandCommand

OPENING_N_M, OPENING_NS_M = 6000.0, 30.0  # per finger, on half the opening
CENTRE_N_M, CENTRE_NS_M = 6000.0, 80.0  # on half the difference
THERE_M = 0.0005


class Hand:
    def __init__(self, command: HandCommand, width_m: float) -> None:
        self.command = command
        self.wanted_m = width_m

    def forces(
        self, fingers: tuple[float, float], speeds: tuple[float, float]
    ) -> tuple[float, float, tuple[float, float]]:
        """Forces of the two finger motors in this tick (N, opening is positive), and with how much of them the fingers
        press towards the middle (N, never negative)."""
        left, right = fingers
        left_speed, right_speed = speeds
        width, command = left + right, self.command
        limit, missing = command.force_n, command.width_m - width
        if self.wanted_m != command.width_m or not -THERE_M <= missing <= THERE_M:
            self._run(width, limit)
        pull = 0.5 * (OPENING_N_M * (self.wanted_m - width) - OPENING_NS_M * (left_speed + right_speed))
        if not -limit < pull < limit:
            pull = max(-limit, min(limit, pull))
        aside = 0.5 * (CENTRE_N_M * (left - right) + CENTRE_NS_M * (left_speed - right_speed))
        left_n, right_n = pull - aside, pull + aside
        return left_n, right_n, (-left_n if left_n < 0.0 else 0.0, -right_n if right_n < 0.0 else 0.0)

    def _run(self, width: float, limit_n: float) -> None:
        target = self.command.width_m
        missing = target - width
        if not -THERE_M <= missing <= THERE_M:
            # Move the setpoint beyond the target, so that the spring reaches its full force on an obstacle.
            stretch = 2.0 * limit_n / OPENING_N_M
            target = min(target, width - stretch) if missing < 0.0 else max(target, width + stretch)
        if target != self.wanted_m:
            most = self.command.speed_m_s * TICK_S
            self.wanted_m += max(-most, min(most, target - self.wanted_m))
