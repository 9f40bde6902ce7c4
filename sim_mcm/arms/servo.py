"""The servo of one arm: computes torques within the motor limits from the wanted motion and the control law.

Pure: its state is the last wanted motion and the law. The module `hand` computes the finger forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import ControlLaw, Load
from rtc.subsystems.motion.arm import Motion
from sim_mcm.arms import control_laws


class Servo:
    """Under every law it also carries the weight of the arm and of the whole load, if the model has gravity."""

    def __init__(self, model: ArmModel, joints: Sequence[float]) -> None:
        self._arm = model
        self._weight = self._weight_of(None)
        self._laws = control_laws.known()
        self._name = ControlLaw()
        self._law = control_laws.make(self._name, model, self._laws)
        self._feel: Callable[[list[float]], None] | None = None
        self._effort: list[float] = model.limits.effort.tolist()
        self._least_effort, self._zeros = min(self._effort), [0.0] * len(self._effort)
        still = [0.0] * len(joints)
        self.wanted: Motion = (list(joints), still, still)  # from the next call of `torque` on

    def use_law(self, law: ControlLaw, joints: Sequence[float]) -> None:
        """Change the law. Raises ValueError if it is unknown, or rejects its figures at the present joints; the old
        law stays. A compliant law starts without the state of an earlier one, and one that has failed anew."""
        if law == self._name and law.compliance is None and not self.fault:
            return
        why = control_laws.beyond_motors(law, self._arm, joints)
        if why:
            raise ValueError(f"control law {law.name}: {why}")
        self._law = control_laws.make(law, self._arm, self._laws)
        if law.load != self._name.load:
            self._weight = self._weight_of(law.load)
        self._name = law
        self._feel = getattr(self._law, "feel", None)

    @property
    def fault(self) -> str:
        """How the present law has failed, or ''."""
        return self._law.failed if isinstance(self._law, control_laws.Installed) else ""

    def feel(self, wrench: list[float]) -> None:
        """The wrench of this tick without its bias, for a law that controls forces."""
        if self._feel is not None:
            self._feel(wrench)

    def _weight_of(self, load: Load | None) -> tuple[pin.Model, pin.Data] | None:
        """Model of the arm with the whole load under gravity; None without gravity."""
        arm = self._arm
        if not arm.model.gravity.linear.any():
            return None
        model = arm.model if load is None else arm.laden(load.mass_kg, load.com_m, load.inertia_kg_m2)
        return model, model.createData()

    def torque(self, joints: list[float], velocities: list[float]) -> list[float]:
        """Torques of this tick, clipped to the motor limits (N.m)."""
        torques = self._law.torque(self.wanted, joints, velocities)
        if self._weight is not None:
            weight = pin.computeGeneralizedGravity(*self._weight, np.array(joints))
            torques = [torque + part for torque, part in zip(torques, weight.tolist(), strict=True)]
        if math.dist(torques, self._zeros) < self._least_effort:  # the norm exceeds every part
            return torques
        return [
            torque if -most < torque < most else (most if torque > 0.0 else -most)
            for torque, most in zip(torques, self._effort)  # noqa: B905 - one length; a check costs in every tick
        ]
