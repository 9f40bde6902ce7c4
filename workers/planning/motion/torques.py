"""Joint torques of a motion with the load in the hand, and their limits. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.advice import by_person
from rtc.protocol.causes import JointTorqueExceeded
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.primitive import Load
from rtc.spatial.geometry import Array

SHARE = 0.9  # of the joints' effort that a planned motion may use; the rest is for the control law
FAR_FROM = 0.6  # of the limits: an arm that needs less at its limits of speed and acceleration is not checked further
POSTURES = 64  # number of postures for that


@dataclass(frozen=True, eq=False)
class Torques:
    """The inverse dynamics of one arm with one load."""

    arm: ArmModel
    load: Load | None
    laden: pin.Model | None
    limits: Array  # N.m

    @classmethod
    def of(cls, arm: ArmModel, load: Load | None) -> Torques:
        laden = arm.laden(load.mass_kg, load.com_m, load.inertia_kg_m2) if load is not None else None
        return cls(arm, load, laden, SHARE * arm.limits.effort)

    @property
    def worst_share(self) -> float:
        """The greatest share of a torque limit at the limits of speed and acceleration, without weight."""
        load = self.load
        key = None if load is None else (load.mass_kg, tuple(load.com_m), tuple(load.inertia_kg_m2))
        return _worst_share(self.arm, key)

    def excess(self, sampled: Callable[[], tuple[Array, Array, Array]]) -> float:
        """The factor by which the accelerations and squared speeds are too great; 1 or less: all within the limits.

        `sampled`: joints, velocities and accelerations, called only if the arm does not need less everywhere.
        Raises Refused if the weight alone is too great for a joint at one of these postures.
        """
        if self.arm.weightless and self.worst_share < FAR_FROM:
            return self.worst_share
        joints, velocities, accelerations = sampled()
        moving = self.arm.torques(joints, velocities, accelerations, self.laden)
        weight = np.zeros_like(moving)
        if not self.arm.weightless:
            still = np.zeros_like(joints)
            weight = self.arm.torques(joints, still, still, self.laden)
            if (np.abs(weight) >= self.limits).any():
                raise Refused(self._overload(weight))
        inertial = moving - weight
        room = np.where(inertial > 0, self.limits - weight, self.limits + weight)
        return float((np.abs(inertial) / room).max())

    def _overload(self, weight: Array) -> Refusal:
        row, joint = np.unravel_index(int((np.abs(weight) / self.limits).argmax()), weight.shape)
        name, torque_nm, limit_nm = self.arm.joints[joint], float(weight[row, joint]), float(self.limits[joint])
        held = f" with {self.load.mass_kg:g} kg in its hand" if self.load is not None else ""
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=(
                f"{self.arm.name} cannot hold itself{held}: {name} would need {abs(torque_nm):.0f} N.m; "
                f"its limit is {limit_nm:.0f} N.m"
            ),
            clears=by_person("a lighter load, or a path nearer to the base"),
            cause=JointTorqueExceeded(arm=self.arm.name, joint=name, torque_nm=torque_nm, limit_nm=limit_nm),
            fraction=float(row) / max(1, len(weight) - 1),
        )


@lru_cache(maxsize=32)
def _worst_share(arm: ArmModel, load: tuple[float, tuple[float, ...], tuple[float, ...]] | None) -> float:
    """In seeded postures, with the worst signs of all accelerations and random signs of all speeds."""
    random = np.random.default_rng(POSTURES)
    model = arm.model if load is None else arm.laden(*load)
    data, limits = model.createData(), SHARE * arm.limits.effort
    still, worst = np.zeros(model.nv), 0.0
    for q in random.uniform(arm.limits.lower, arm.limits.upper, (POSTURES, model.nq)):
        upper = np.triu(pin.crba(model, data, q))
        inertial = np.abs(upper + np.triu(upper, 1).T) @ arm.limits.acceleration
        speeds = arm.limits.velocity * random.choice((-1.0, 1.0), model.nv)
        centrifugal = np.abs(pin.rnea(model, data, q, speeds, still))
        worst = max(worst, float(((inertial + centrifugal) / limits).max()))
    return worst
