"""The profile of an operated arm: joint motion that follows a twist of the tcp. Pure.

Each tick turns the wanted twist into joint speeds by damped least squares, keeps them within the limits of the joints,
and approaches them within an acceleration. So the command is smooth whatever the stream does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from rtc.protocol.units import measured_in_words
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion, Traits
from rtc.subsystems.motion.clearance import Guide
from rtc.subsystems.motion.profiles import LADEN_ACCELERATION_RAD_S2, STOP_ACCELERATION_RAD_S2

DAMPING = 0.02  # of the least squares: near a singular posture the arm is slow instead of fast
# Maximum joint speeds (rad/s): from them the arm stops within 40 ms; with an object in the hand it brakes more softly.
FASTEST_RAD_S, LADEN_RAD_S = 0.45, 0.16
REFRESH_TICKS = 5  # the Jacobian follows the posture at this interval
MARGIN_RAD = 0.03  # kept to joint limits; F trips at a smaller one


class Jog:
    """`wanted`: the twist now (m/s, rad/s, world axes). `most_m_s`: of the tcp. It has no end of its own."""

    duration_s = math.inf

    def __init__(
        self,
        start: Sequence[float],
        traits: Traits,
        jacobian: Callable[[Sequence[float]], Array],
        wanted: Callable[[], Sequence[float]],
        *,
        laden: bool,
        most_m_s: float = math.inf,
        shared: bool = False,
    ) -> None:
        self._jacobian, self._wanted = jacobian, wanted
        self._joints, self._speeds = np.array(start, dtype=float), np.zeros(len(start))
        self._limits = traits.lower, traits.upper
        margin = np.array(traits.margins(MARGIN_RAD))
        self._lower, self._upper = np.array(traits.lower) + margin, np.array(traits.upper) - margin
        fastest = LADEN_RAD_S if laden else FASTEST_RAD_S
        self._fastest = np.minimum(0.5 * np.array(traits.velocity), fastest)
        self._accelerates = min(min(traits.acceleration), LADEN_ACCELERATION_RAD_S2 if laden else math.inf)
        self._brakes = LADEN_ACCELERATION_RAD_S2 if laden else STOP_ACCELERATION_RAD_S2
        self._inverse: Array = np.zeros((len(start), 6))
        self._forward, self._most_m_s, self._shared = np.zeros((3, len(start))), most_m_s, shared
        self._ticks = 0
        self._names, self._slides = traits.joint_names, traits.slides or [False] * len(start)
        self.guides: list[Guide] = []  # they keep the arm away from bodies
        self.cut = ""  # why the arm moves less than is wanted

    def at(self, time_s: float) -> Motion:
        """One tick further, whatever the time."""
        aim = self._aim()
        change = aim - self._speeds
        harder = np.abs(aim) < np.abs(self._speeds)
        most = np.where(harder, self._brakes, self._accelerates) * TICK_S
        # One factor for all joints, so that the tcp keeps its direction.
        change *= min(1.0, float((most / np.maximum(np.abs(change), 1e-12)).min()))
        self._speeds = self._speeds + change
        self._joints = self._joints + self._speeds * TICK_S
        return self._joints.tolist(), self._speeds.tolist(), (change / TICK_S).tolist()

    def _aim(self) -> Array:
        """The joint speeds that give the wanted twist, within the limits."""
        wanted = np.asarray(self._wanted(), dtype=float)
        self.cut = ""
        if not wanted.any():
            return np.zeros_like(self._speeds)
        if self._ticks % REFRESH_TICKS == 0:
            jacobian = self._jacobian(self._joints.tolist())
            self._forward = jacobian[:3]
            square = jacobian @ jacobian.T + DAMPING**2 * np.eye(6)
            self._inverse = jacobian.T @ np.linalg.inv(square)
        self._ticks += 1
        for guide in self.guides:
            guide.at(self._joints)
            if not self._shared:
                wanted = guide.slide(wanted)
        aim: Array = self._inverse @ wanted
        aim = aim * min(1.0, float((self._fastest / np.maximum(np.abs(aim), 1e-12)).min()))
        # Near a singular posture the least squares give a turn that moves the tcp, also faster than it may.
        aim = aim * min(1.0, self._most_m_s / max(float(np.linalg.norm(self._forward @ aim)), 1e-12))
        ahead = self._joints + aim * np.abs(aim) / (2.0 * self._brakes) + aim * TICK_S
        beyond = ((ahead < self._lower) & (aim < 0.0)) | ((ahead > self._upper) & (aim > 0.0))
        if beyond.any():
            self.cut = self._at_limit(int(beyond.argmax()), aim)
            return np.zeros_like(aim)
        for guide in self.guides:
            aim = guide.slow(aim)
        self.cut = next((guide.cut for guide in self.guides if guide.cut), "")
        return aim

    def _at_limit(self, joint: int, aim: Array) -> str:
        limit = (self._limits[1] if aim[joint] > 0.0 else self._limits[0])[joint]
        unit = "m" if self._slides[joint] else "rad"
        return f"{self._names[joint]} is at its limit of {measured_in_words(limit, unit)}"
