"""The wrench at the tcp from joint torques, for an arm without a wrist sensor. Pure.

In each tick the motion of the joints is compared with the one that the motor torques of that tick would cause. What
remains is the torque of the environment, which the Jacobian converts to a wrench at the tcp by least squares. A contact
of another link counts as a wrench at the tcp, too. Near a singularity, forces along a lost direction are not measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.primitive import Load
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S

FILTER_S = 0.002  # time constant of the filter of the torques
DAMPING = 1e-3  # of the least squares, so that a singular posture has a finite wrench


class JointTorques:
    """Estimates one wrench per tick. The state is that of the tick before, and the filter."""

    def __init__(self, arm: ArmModel) -> None:
        self._arm = arm
        self._model, self._data = arm.model, arm.model.createData()
        self._before: tuple[Array, Array] | None = None  # joints, velocities
        self._torques: Array | None = None
        self._external = np.zeros(arm.model.nv)
        self._share = TICK_S / (FILTER_S + TICK_S)

    def carry(self, load: Load | None) -> None:
        """The load in the hand from now on: its weight and inertia are not forces of the environment."""
        model: Any = self._arm.model
        if load is not None:
            model = self._arm.laden(load.mass_kg, load.com_m, load.inertia_kg_m2)
        self._model, self._data = model, model.createData()

    def drive(self, torques: Sequence[float]) -> None:
        """The motor torques (N.m) of the tick that begins."""
        self._torques = np.array(torques)

    def wrench(self, joints: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """[Fx Fy Fz Tx Ty Tz] (N, N.m) on the hand, tool axes, about the tcp.

        `joints` (rad), `velocities` (rad/s): at the end of that tick. Further calls within a tick change nothing.
        """
        q, v = np.array(joints), np.array(velocities)
        if self._before is not None and self._torques is not None:
            q_before, v_before = self._before
            needed = pin.rnea(self._model, self._data, q_before, v_before, (v - v_before) / TICK_S)
            self._external += self._share * (needed - self._torques - self._external)
        self._before, self._torques = (q, v), None
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._arm.tcp_frame, pin.LOCAL)
        squared = jacobian @ jacobian.T
        squared[np.diag_indices(6)] += DAMPING
        found: list[float] = np.linalg.solve(squared, jacobian @ self._external).tolist()
        return found

    def begin(self) -> None:
        """Forget the past, after the arm was set to another state."""
        self._before = self._torques = None
        self._external[:] = 0.0
