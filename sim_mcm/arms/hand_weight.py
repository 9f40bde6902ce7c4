"""Under gravity: the wrist sensor without the weight that it carries, and with the twist that pybullet leaves out.

pybullet's joint feedback lacks the torsional friction of the pads. So a load whose centre of mass is not between the
pads shows a force that is not there: 6 N per N.m. `PadTwist` finds the missing torque from the joint torques and the
measured acceleration. Pure, except for the last torque set-point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import Load
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

Y = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # the pads press along tool y, so their friction twists about it
FITS = 0.3  # the twist counts if it explains the joint torques up to this part; else something else touches


class HandWeight:
    """Weight of what the wrist sensor carries: the hand, and the load of the control law.

    `hand`: inertia in tool axes about the tcp; `gravity_m_s2`: world axes.
    """

    def __init__(self, hand: pin.Inertia, gravity_m_s2: geometry.Floats) -> None:
        self._hand, self._gravity = hand, np.asarray(gravity_m_s2)

    def removed(self, wrench: list[float], tcp: Array, load: Load | None) -> list[float]:
        """The wrench of the environment: `wrench` (tool axes, about the tcp at the pose `tcp`) without the weights."""
        down = geometry.rotate(geometry.inverse(tcp), self._gravity)
        felt = np.array(wrench)
        parts = [(self._hand.mass, self._hand.lever)]
        if load is not None:
            parts.append((load.mass_kg, np.asarray(load.com_m)))
        for mass_kg, centre_m in parts:
            felt[:3] -= mass_kg * down
            felt[3:] -= np.cross(centre_m, mass_kg * down)
        without: list[float] = felt.tolist()
        return without


class PadTwist:
    """The torque about the closing direction that both pads exert by torsional friction."""

    def __init__(self, arm: ArmModel, hand: pin.Inertia) -> None:
        self._model, self._data, self._tcp = arm.model, arm.model.createData(), arm.tcp_frame
        tip = arm.model.frames[arm.tcp_frame]
        self._rest = arm.model.copy()  # the arm without its hand
        last = self._rest.inertias[tip.parentJoint].toDynamicParameters()
        last = last - tip.placement.act(hand).toDynamicParameters()
        self._rest.inertias[tip.parentJoint] = pin.Inertia.FromDynamicParameters(last)
        self._rest_data, self._hand = self._rest.createData(), hand.matrix()

    def added(self, wrench: list[float], q: Any, v: Any, acceleration: Array, torques: list[float]) -> list[float]:
        """The true reading. `wrench`: as read, tool axes; the rest: joints (rad), velocities, accelerations of the step
        in which it was read, and the torques that acted in it (N.m)."""
        q, v = np.asarray(q), np.asarray(v)
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._tcp, pin.LOCAL)
        upper = np.triu(pin.crba(self._model, self._data, q))
        mass = upper + np.triu(upper, 1).T
        moved = jacobian @ np.linalg.solve(mass, jacobian[4])  # acceleration of the tcp by one newton metre
        error = Y - self._hand @ moved  # of the reading, by the same
        read = jacobian.T @ np.array(wrench)
        missing = pin.rnea(self._rest, self._rest_data, q, v, acceleration) - np.array(torques) - read
        one = jacobian.T @ error
        square = float(one @ one)
        if square < 1e-12:  # no joint feels it
            return wrench
        twist_nm = float(one @ missing) / square
        if np.linalg.norm(missing - twist_nm * one) > FITS * np.linalg.norm(missing):
            return wrench
        true: list[float] = (np.array(wrench) + twist_nm * error).tolist()
        return true
