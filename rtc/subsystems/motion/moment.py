"""What a check of a stop function sees: the measurements of one tick, and values derived from them. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import Near

Finding = tuple[float | None, float | None, str]  # measured, limit, words


class Moment(msgspec.Struct):
    """The input of a check: the sample of this tick with the bias subtracted from the wrench, and derived values."""

    elapsed_s: float
    joints: list[float]
    velocities: list[float]
    wrench: list[float]
    force_n: float  # magnitudes
    torque_nm: float
    fingers: tuple[float, float]  # as in Sample
    finger_forces: tuple[float, float]
    arrived: Finding | None  # (greatest error, tolerance, '') once the goal is reached
    tcp: Callable[[], Array]  # called on demand: tcp and touch cost more than the other values
    touch: Callable[[], str]
    commanded: list[float]  # commanded joints of this tick (rad)
    commanded_tcp: Callable[[], Array]
    tcp_speed_m_s: Callable[[], float]
    arm_touch: Callable[[], str] = str  # contact with another arm, in words
    near: Callable[[float], Sequence[Near]] = lambda within_m: ()  # bodies within a distance (m), see ArmInterface

    @property
    def width_m(self) -> float:
        return self.fingers[0] + self.fingers[1]

    @property
    def grip_n(self) -> float:
        """Force of the finger that presses less."""
        return min(self.finger_forces)
