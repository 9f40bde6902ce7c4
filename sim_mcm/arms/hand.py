"""The servo of a parallel hand: finger forces from opening, speed and the command. Pure; one tick at a time.

The setpoint of the opening moves to the commanded width at the commanded speed. A virtual spring, limited to the
commanded force, pulls the fingers towards it. With an object between the fingers the spring stretches until that force
is reached, and then holds it. Once the width is reached, the setpoint stays there: a finger that is pushed aside meets
the spring alone. A setpoint that runs whenever the fingers are pushed away makes them shake at a touch. A second spring
keeps the fingers in the middle of the hand, so it centres the hand over the object (measured values: docs/physics.md).

The gains are those of fingers of 0.1 kg. A lighter finger gets as much of them as a tick of 1 ms permits: beyond that
the fingers shake, and the arm with them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rtc.subsystems.motion.arm import TICK_S, HandCommand

FINGER_N_M = 6000.0  # per finger, on half the opening and on half the difference
OPENING_NS_M, CENTRE_NS_M = 30.0, 80.0  # their damping
# Greatest change of a finger in one tick, as a share: of its speed by the damping, of its position by the spring. Above
# a sum of 2, the second counted half, the fingers shake.
MAX_DAMPED, MAX_SPRUNG = 1.4, 0.3
THERE_M = 0.0005


class Gains(NamedTuple):
    spring_n_m: float
    opening_ns_m: float
    centre_ns_m: float


def gains_of(finger_kg: float) -> Gains:
    """The gains of a hand whose fingers have this mass each, as their motors feel it."""
    spring, damping = MAX_SPRUNG * finger_kg / TICK_S**2, MAX_DAMPED * finger_kg / TICK_S
    return Gains(min(FINGER_N_M, spring), min(OPENING_NS_M, damping), min(CENTRE_NS_M, damping))


class SimulatedHand:
    """`finger_kg`: the mass of each finger, as its motor feels it."""

    def __init__(self, command: HandCommand, width_m: float, finger_kg: float = math.inf) -> None:
        self.command = command
        self.wanted_m = width_m
        self._reached: HandCommand | None = None  # the command whose width was reached
        self._spring_n_m, self._opening_ns_m, self._centre_ns_m = gains_of(finger_kg)

    def forces(
        self, fingers: tuple[float, float], speeds: tuple[float, float]
    ) -> tuple[float, float, tuple[float, float]]:
        """Forces of the two finger motors in this tick (N, opening is positive), and with how much of them the fingers
        press towards the middle (N, never negative)."""
        left, right = fingers
        left_speed, right_speed = speeds
        width, command = left + right, self.command
        limit, missing = command.force_n, command.width_m - width
        if self._reached is not command:
            self._run(width, limit)
            if self.wanted_m == command.width_m and -THERE_M <= missing <= THERE_M:
                self._reached = command
        pull = 0.5 * (self._spring_n_m * (self.wanted_m - width) - self._opening_ns_m * (left_speed + right_speed))
        if not -limit < pull < limit:
            pull = max(-limit, min(limit, pull))
        aside = 0.5 * (self._spring_n_m * (left - right) + self._centre_ns_m * (left_speed - right_speed))
        left_n, right_n = pull - aside, pull + aside
        return left_n, right_n, (-left_n if left_n < 0.0 else 0.0, -right_n if right_n < 0.0 else 0.0)

    def hold(self, width_m: float) -> None:
        """Stay at this opening until the next command."""
        self.command = HandCommand(width_m, self.command.force_n, self.command.speed_m_s)
        self.wanted_m = width_m

    def _run(self, width: float, limit_n: float) -> None:
        target = self.command.width_m
        missing = target - width
        if not -THERE_M <= missing <= THERE_M:
            # Move the setpoint beyond the target, so that the spring reaches its full force on an obstacle.
            stretch = 2.0 * limit_n / self._spring_n_m
            target = min(target, width - stretch) if missing < 0.0 else max(target, width + stretch)
        if target != self.wanted_m:
            most = self.command.speed_m_s * TICK_S
            self.wanted_m += max(-most, min(most, target - self.wanted_m))
