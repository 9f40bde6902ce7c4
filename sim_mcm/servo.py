"""One arm's servo: from the motion wanted, through the law in use, to torques within the motors' limits.

Pure: it holds what was last wanted and the law, nothing else. Torque in the fingers is the hand's (see `hand`).
"""

from __future__ import annotations

from collections.abc import Sequence

from rtc.primitive import ControlLaw
from rtc.robot.kinematics import ArmModel
from sim_mcm import control_laws
from sim_mcm.arm import Motion


class Servo:
    def __init__(self, model: ArmModel, joints: Sequence[float]) -> None:
        self._arm = model
        self._laws = control_laws.known()
        self._name = ControlLaw()
        self._law = control_laws.make(self._name, model, self._laws)
        self._effort: list[float] = model.limits.effort.tolist()
        still = [0.0] * len(joints)
        self._wanted: Motion = (list(joints), still, still)

    def use_law(self, law: ControlLaw) -> None:
        """ValueError, in words, when there is no such law or its gains will not do; the old one then stays."""
        if law != self._name:
            self._law = control_laws.make(law, self._arm, self._laws)
            self._name = law

    def want(self, motion: Motion) -> None:
        self._wanted = motion

    def torque(self, joints: list[float], velocities: list[float]) -> list[float]:
        """For this tick, clipped to what the motors can (N.m)."""
        torques = self._law.torque(self._wanted, joints, velocities)
        return [
            torque if -most < torque < most else (most if torque > 0.0 else -most)
            for torque, most in zip(torques, self._effort, strict=True)
        ]
