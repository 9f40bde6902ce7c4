"""The servo of one arm: computes torques within the motor limits from the wanted motion and the control law.

Pure: its state is the last wanted motion and the law. The module `hand` computes the finger forces.
"""

from __future__ import annotations

from collections.abc import Sequence

from rtc.protocol.primitive import ControlLaw
from rtc.robot.kinematics import ArmModel
from sim_mcm.arms import control_laws
from sim_mcm.arms.arm import Motion


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
        """Change the law. Raises ValueError if it is unknown or rejects the gains; the old law stays."""
        if law != self._name:
            self._law = control_laws.make(law, self._arm, self._laws)
            self._name = law

    def want(self, motion: Motion) -> None:
        self._wanted = motion

    def torque(self, joints: list[float], velocities: list[float]) -> list[float]:
        """Torques of this tick, clipped to the motor limits (N.m)."""
        torques = self._law.torque(self._wanted, joints, velocities)
        return [
            torque if -most < torque < most else (most if torque > 0.0 else -most)
            for torque, most in zip(torques, self._effort, strict=True)
        ]
