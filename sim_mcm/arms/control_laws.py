"""Control laws by name (M in the paper; R63, R99).

A law computes joint torques from the wanted and the measured motion. The project has `position` (here) and `impedance`
(`impedance.py`). Installed packages add others by an entry point of the group `rtc.control_laws`: NAME = module:factory

    factory(model: pin.Model, gains: dict[str, float]) -> Law        raises ValueError for unacceptable gains

`model` is the arm without fingers, with a share of the primitive's load. It has no gravity: the servo adds the weight.
A law must not know sockets, samples or primitives. One of a package that fails is replaced by `position` at once, and
the primitive ends.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from rtc.model.robot.kinematics import ArmModel
from rtc.plugins import guard, registry
from rtc.plugins.guard import PluginError
from rtc.protocol.primitive import ControlLaw
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import Motion
from sim_mcm.arms import unrolled
from sim_mcm.arms.impedance import Impedance

# Share of the load in the model. With 0 the wrist swings after a halt with two kilograms (1.1 s until rest); with this
# share it rests in 0.45 s. With 0.25 the wrist chatters: it is twenty times lighter than the load, held by friction.
LOAD_SHARE = 0.10


class Law(Protocol):
    def torque(self, wanted: Motion, q: list[float], v: list[float]) -> list[float]:
        """Joint torques (N.m) that bring an arm at `q` (rad), `v` (rad/s) to the wanted q, v, acceleration.

        Called every millisecond for every arm. Lists are faster than arrays for six numbers.
        """


Factory = Callable[[Any, dict[str, float]], Law]


class ComputedTorque:
    """Position control: every joint behaves like a unit mass on a critically damped spring of frequency `wn`.

    At wn 150 a 0.25 m/s line is followed within 0.01 mm; beyond 300 the sampling at 1 kHz makes it chatter.
    """

    def __init__(self, model: Any, gains: dict[str, float]) -> None:
        wn = gains.get("wn", 150.0)
        if set(gains) - {"wn"}:
            raise ValueError(f"control law position knows the gain wn, not {', '.join(sorted(set(gains) - {'wn'}))}")
        if not 10.0 <= wn <= 300.0:
            raise ValueError(f"control law position: wn {wn} rad/s is outside 10 to 300")
        self._model, self._data = model, model.createData()
        self._stiffness, self._damping = wn * wn, 2.0 * wn
        rows = np.zeros((3, model.nv))  # q, v, a
        self._rows, self._state = tuple(rows), rows.data
        self._pack_into = struct.Struct(f"{rows.size}d").pack_into  # three times as fast as np.array
        self._fill = unrolled.fill_computed_torque(model.nv)

    def torque(self, wanted: Motion, q: list[float], v: list[float]) -> list[float]:
        self._fill(self._pack_into, self._state, wanted, q, v, self._stiffness, self._damping)
        torque: list[float] = pin.rnea(self._model, self._data, *self._rows).tolist()
        return torque


IMPEDANCE = "impedance"


def known() -> dict[str, Factory]:
    """All installed laws that need no compliance, by name."""
    return {"position": ComputedTorque, **registry.installed(registry.CONTROL_LAWS)}


def make(law: ControlLaw, arm: ArmModel, laws: Mapping[str, Factory]) -> Law:
    """The law that a primitive names. Raises ValueError if it is unknown or rejects its figures."""
    if law.name != IMPEDANCE and law.name not in laws:
        raise ValueError(unknown("control law", law.name, [*laws, IMPEDANCE]))
    if not all(np.isfinite(value) for value in law.gains.values()):
        raise ValueError(f"control law {law.name}: a gain is not a finite number")
    load = law.load
    if load is None:
        model = arm.model
    else:
        inertia = [LOAD_SHARE * part for part in load.inertia_kg_m2]
        model = arm.laden(LOAD_SHARE * load.mass_kg, load.com_m, inertia)
    if model.gravity.linear.any():  # the servo carries all weight
        model = model.copy()
        model.gravity.linear[:] = 0.0
    if law.name == IMPEDANCE:
        return _impedance(law, arm, model)
    if law.compliance is not None:
        raise ValueError(f"control law {law.name} has no compliance; {IMPEDANCE} has")
    if law.name not in registry.installed(registry.CONTROL_LAWS):
        return laws[law.name](model, law.gains)
    guard.begin_anew()  # one that was cut off may be tried again
    try:
        with registry.guarded(registry.CONTROL_LAWS, law.name):
            return Installed(law.name, laws[law.name](model.copy(), dict(law.gains)), ComputedTorque(arm.model, {}))
    except PluginError as error:
        raise ValueError(str(error)) from None


class Installed:
    """A law of a package. From its first failure on `own` holds the arm on its way, and `failed` states the failure."""

    def __init__(self, name: str, law: Law, own: Law) -> None:
        self._name, self._law, self._own = name, law, own
        self.failed = ""

    def torque(self, wanted: Motion, q: list[float], v: list[float]) -> list[float]:
        own = self._own.torque(wanted, q, v)
        if self.failed:
            return own
        try:
            with registry.guarded(registry.CONTROL_LAWS, self._name):
                found = [float(part) for part in self._law.torque(tuple(map(list, wanted)), [*q], [*v])]  # type: ignore[arg-type]
                if len(found) != len(own) or not all(map(math.isfinite, found)):
                    raise ValueError(f"expected are {len(own)} finite torques")
        except PluginError as error:
            self.failed = str(error)
            return own
        return found


def _impedance(law: ControlLaw, arm: ArmModel, model: Any) -> Law:
    ComputedTorque(model, law.gains)  # it holds the arm afterwards, so its gains must be acceptable
    if law.compliance is None:
        raise ValueError(f"control law {IMPEDANCE} needs the figures of its compliance")
    base = geometry.to_matrix(arm.base_pose)[:3, :3]
    return Impedance(model, arm.tcp_frame, base, law.compliance, arm.limits.effort)


def beyond_motors(law: ControlLaw, arm: ArmModel, joints: Sequence[float]) -> str:
    """Why the motors cannot exert the force set-points at this posture, or ''."""
    compliance = law.compliance
    if compliance is None:
        return ""
    jacobian, effort = arm.jacobian(joints), arm.limits.effort
    wrench = np.array([force or 0.0 for force in compliance.wrench or [None] * 6])
    if compliance.frame == "tool":
        turn = geometry.to_matrix(arm.fk(joints))[:3, :3]
        wrench = np.concatenate((turn @ wrench[:3], turn @ wrench[3:]))
    torque = np.abs(jacobian.T @ wrench)
    worst = int(np.argmax(torque / effort))
    if torque[worst] <= effort[worst]:
        return ""
    return (
        f"the force set-point needs {torque[worst]:.3g} N.m of {arm.joints[worst]} at the start; "
        f"its motor has {effort[worst]:g} N.m"
    )
