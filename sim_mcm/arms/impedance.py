"""The control law `impedance`: the tool behaves like a spring and damper about its commanded path. Pure.

    torque = rnea(q, v, wanted acceleration) + J' (K e + D de + force part)

e and de are errors of pose and velocity along the axes of the selection frame, at the centre of compliance. J is the
Jacobian of this point of the tool, by default the tcp. D is scaled by the effective mass
matrix: D = Z (sqrt(L) sqrt(K) + sqrt(K) sqrt(L)), symmetric, with L = (J M^-1 J')^-1 and damping ratios Z. An axis with
a force set-point has no spring: it presses with the set-point plus an integral of the force error. Nothing may resist
it, so it presses with no more than brings it to its speed of approach within a tick. This module must not know sockets,
samples or primitives.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pinocchio as pin

from rtc.protocol.primitive import Compliance
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, Motion

# Beyond these a spring on the lightest axis of a wrist oscillates with the sampling at 1 kHz.
MAX_N_M, MAX_NM_RAD = 5000.0, 300.0
REFRESH_TICKS = 10  # the damping follows the posture at this interval; it costs more than all the rest
MIN_INVERSE_MASS = 1e-4  # added to (J M^-1 J') so that a singular posture has a finite effective mass
APPROACH_RAD_S = 0.05  # greatest speed of an axis with a torque set-point that touches nothing
# Damping of an axis without a spring: that of this spring (N/m, N.m/rad), whatever the set-point.
IDLE_N_M, IDLE_NM_RAD = 1000.0, 20.0
MAX_DAMPED = 0.4  # share of an axis' momentum that its damping may take in one tick
INTEGRAL_PER_S = 5.0  # gain of the force integral; 2 to 20 are stable on a rigid wall
# Anti-windup: the integral is at most this share of the set-point, and at least the floor below (N, N.m). It rests
# while the axis touches nothing (a measured force below TOUCHING of the set-point) and while a motor is at its limit.
MAX_INTEGRAL, MIN_INTEGRAL_N, MIN_INTEGRAL_NM = 0.5, 2.0, 0.2
TOUCHING = 0.1


class Impedance:
    """One arm under Cartesian impedance. `model`: dynamics with the load; `tcp`: its frame; `base`: base in world."""

    def __init__(self, model: Any, tcp: int, base: Array, compliance: Compliance, effort: Array) -> None:
        for value, most, unit in (
            *((k, MAX_N_M, "N/m") for k in compliance.stiffness[:3]),
            *((k, MAX_NM_RAD, "N.m/rad") for k in compliance.stiffness[3:]),
        ):
            if value > most:
                raise ValueError(f"control law impedance: stiffness {value:g} {unit} is above {most:g} {unit}")
        self._model, self._data, self._wanted_data = model, model.createData(), model.createData()
        self._tcp, self._base, self._effort = tcp, base, effort
        self._lower = np.tril_indices(model.nv, -1)
        rows = np.zeros((5, model.nv))  # q, v and the wanted q, v, a
        self._rows, self._state = tuple(rows), rows.data
        self._fill = struct.Struct(f"{rows.size}d").pack_into  # several times as fast as np.array
        self._in_tool = compliance.frame == "tool"
        self._pressed = np.array([force is not None for force in compliance.wrench or [None] * 6])
        self._stiffness = np.where(self._pressed, 0.0, compliance.stiffness)
        idle = np.array([IDLE_N_M] * 3 + [IDLE_NM_RAD] * 3)
        self._root = np.sqrt(np.where(self._stiffness == 0.0, idle, self._stiffness))
        self._ratio = np.array(compliance.damping)
        self._most_n, self._most_nm = compliance.most_n, compliance.most_nm
        self._damping = np.zeros((6, 6))
        self._approach = np.array([compliance.approach_m_s] * 3 + [APPROACH_RAD_S] * 3)
        self._own_damping = np.zeros(6)
        self._mass_per_s = np.zeros(6)  # of each axis by the time of a tick: N that change its speed by 1 m/s
        self._ticks = 0
        self._set_point = np.array([force or 0.0 for force in compliance.wrench or [None] * 6])
        self._profile = compliance.profile
        self._integral = np.zeros(6)
        self._measured = np.zeros(6)
        self._saturated = False
        self._presses = bool(self._pressed.any())
        self._centre = np.array(compliance.centre) if compliance.centre else None
        self._to_centre = np.eye(6)  # velocity of the tcp to that of the centre, tool axes
        if self._centre is not None:
            self._to_centre[:3, 3:] = -pin.skew(self._centre)

    def feel(self, wrench: list[float]) -> None:
        """The measured wrench of this tick: of the environment on the hand, tool axes, about the tcp, without bias."""
        self._measured[:] = wrench
        if self._centre is not None:
            self._measured[3:] += self._to_centre[:3, 3:] @ self._measured[:3]

    def torque(self, wanted: Motion, q: list[float], v: list[float]) -> list[float]:
        model, data = self._model, self._data
        self._fill(self._state, 0, *q, *v, *wanted[0], *wanted[1], *wanted[2])
        q_now, v_now, q_wanted, v_wanted, a_wanted = self._rows
        torque = pin.rnea(model, data, q_now, v_now, a_wanted)
        pin.computeJointJacobians(model, data, q_now)
        here = pin.updateFramePlacement(model, data, self._tcp)
        jacobian = pin.getFrameJacobian(model, data, self._tcp, pin.LOCAL)
        pin.forwardKinematics(model, self._wanted_data, q_wanted, v_wanted)
        there = pin.updateFramePlacement(model, self._wanted_data, self._tcp)
        moving = pin.getFrameVelocity(model, self._wanted_data, self._tcp, pin.LOCAL_WORLD_ALIGNED)

        turn = here.rotation.T  # base axes to tool axes
        error, wanted_speed = np.empty(6), np.empty(6)
        turned = turn @ there.rotation
        error[:3] = turn @ (there.translation - here.translation)
        error[3:] = pin.log3(turned)
        wanted_speed[:3], wanted_speed[3:] = turn @ moving.linear, turn @ moving.angular
        if self._centre is not None:
            arm = turned @ self._centre  # from the wanted tcp to the wanted centre
            error[:3] += arm - self._centre
            wanted_speed[:3] -= pin.skew(arm) @ wanted_speed[3:]
            jacobian = self._to_centre @ jacobian
        speed_error = wanted_speed - jacobian @ v_now

        selection = None if self._in_tool else self._base @ here.rotation  # tool axes to world axes
        if self._ticks % REFRESH_TICKS == 0:
            self._refresh(q_now, jacobian, selection)
        self._ticks += 1
        pull = self._spring(error if selection is None else _turned(selection, error))
        if self._presses:
            pull += self._force(selection, -speed_error)
        if selection is not None:
            pull = _turned(selection.T, pull)
        torque += jacobian.T @ (pull + self._damping @ speed_error)
        if self._presses:
            self._saturated = bool((np.abs(torque) >= self._effort).any())
        found: list[float] = torque.tolist()
        return found

    def _spring(self, error: Array) -> Array:
        """Pull of the spring along the selection axes; force and torque are each limited in magnitude."""
        pull: Array = self._stiffness * error
        for part, most in ((pull[:3], self._most_n), (pull[3:], self._most_nm)):
            if most is not None:
                size = math.sqrt(part[0] ** 2 + part[1] ** 2 + part[2] ** 2)
                if size > most:
                    part *= most / size
        return pull

    def _force(self, selection: Array | None, speed: Array) -> Array:
        """Push along the force-controlled axes: set-point and integral of the force error. `speed`: tool axes."""
        felt = -self._measured if selection is None else _turned(selection, -self._measured)
        speed = speed if selection is None else _turned(selection, speed)
        wanted = self._set_point
        if self._profile is not None:
            wanted = wanted * np.interp(self._ticks * TICK_S, self._profile.time_s, self._profile.share)
        error, way = wanted - felt, np.sign(wanted)
        touching = way * felt > TOUCHING * np.abs(wanted)
        if not self._saturated:
            self._integral += np.where(self._pressed & touching, INTEGRAL_PER_S * TICK_S * error, 0.0)
        most = np.maximum(MAX_INTEGRAL * np.abs(wanted), [MIN_INTEGRAL_N] * 3 + [MIN_INTEGRAL_NM] * 3)
        np.clip(self._integral, -most, most, out=self._integral)
        # Without resistance the axis would pass its speed of approach; what resists may not be felt at once.
        room = self._mass_per_s * (self._approach - way * speed) + self._own_damping * way * speed
        most_free = np.maximum(0.0, room + np.maximum(0.0, way * felt))
        push: Array = np.where(self._pressed, way * np.minimum(np.abs(wanted), most_free) + self._integral, 0.0)
        return push

    def _refresh(self, q: Array, jacobian: Array, selection: Array | None) -> None:
        """Damping matrix (tool axes) for this posture."""
        mass = pin.crba(self._model, self._data, q)  # only its upper triangle is set
        mass[self._lower] = mass.T[self._lower]
        inverse: Array = jacobian @ np.linalg.solve(mass, jacobian.T)
        inverse.flat[::7] += MIN_INVERSE_MASS
        both = np.zeros((6, 6))
        if selection is not None:
            both[:3, :3] = both[3:, 3:] = selection
            inverse = both @ inverse @ both.T
        values, vectors = np.linalg.eigh(inverse)
        root_mass = (vectors / np.sqrt(values)) @ vectors.T  # sqrt of the effective mass
        shaped = root_mass * (self._ratio * self._root)
        damping: Array = shaped + shaped.T
        if self._presses:
            slow = np.abs(self._set_point) / self._approach
            most = MAX_DAMPED / (np.diag(inverse) * TICK_S)
            own = np.diag(damping)
            extra = np.clip(np.minimum(slow, most) - own, 0.0, None)
            damping.flat[::7] += np.where(self._pressed, extra, 0.0)
            self._mass_per_s = 1.0 / (np.diag(inverse) * TICK_S)
            self._own_damping = np.diag(damping)
        self._damping = damping if selection is None else both.T @ damping @ both


def _turned(rotation: Array, wrench: Array) -> Array:
    found = np.empty(6)
    found[:3], found[3:] = rotation @ wrench[:3], rotation @ wrench[3:]
    return found
