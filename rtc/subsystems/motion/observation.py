"""What an executor measures of its arm: in this tick, over a window of ticks, and since the start of a primitive. Pure.

Values that few primitives need are computed on demand: the tcp pose, its speed, contacts, rest. This module must not
know states, trajectories or reports.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import dist

from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, ArmInterface, Motion, Sample
from rtc.subsystems.motion.moment import Finding, Moment

# Rest means that joints and fingers stay within these spreads for a window of ticks. Speeds are not used: they
# alternate from tick to tick while a held object is pressed. Equal to 0.005 rad/s and 0.002 m/s of uniform motion.
WINDOW_TICKS = 20
REST_RAD, REST_M = 0.005 * WINDOW_TICKS * TICK_S, 0.002 * WINDOW_TICKS * TICK_S
LEAN_N = 20.0  # a contact force that has increased by this since the start is a new touch


class Observation:
    """`arm` may be replaced between ticks. Call `read` in every tick, and `feel` in those of a primitive."""

    def __init__(self, arm: ArmInterface) -> None:
        self.arm = arm
        self.sample = arm.read()
        # Magnitudes of the wrench minus the bias, of the latest tick of a primitive.
        self.force_n = self.torque_nm = 0.0
        self.peak_force_n = self.peak_torque_nm = 0.0  # of the primitive, in states that count them
        # In the window. Whole samples would take much of the nearest cache of the processor.
        self._joints = deque([self.sample.joints], WINDOW_TICKS)
        self._fingers = deque([self.sample.fingers], WINDOW_TICKS)
        self._bias = [0.0] * 6
        self._bias_force, self._bias_torque = self._bias[:3], self._bias[3:]
        self._touched_before: dict[str, float] = {}
        self._tcp_of: Sample | None = None  # the sample that `_tcp_pose` belongs to
        self._tcp_pose: Array = arm.tcp_pose(self.sample.joints)
        self._moment = self._first_moment()
        self.stands_at = self.sample.joints  # without a primitive

    @property
    def joints(self) -> list[float]:
        """Rad; m for those of `slides`."""
        return self.sample.joints

    @property
    def slides(self) -> list[int]:
        """Numbers of the joints that slide."""
        return [n for n, sliding in enumerate(self.arm.traits.slides) if sliding]

    def read(self) -> None:
        """Take the sample of this tick."""
        self.sample = self.arm.read()
        self.watch()

    def watch(self) -> None:
        """Let the sample of this tick enter the window."""
        self._joints.append(self.sample.joints)
        self._fingers.append(self.sample.fingers)

    def forget_window(self) -> None:
        """Ticks pass that are not watched: there is no rest until a whole window has been watched after them."""
        self._joints.append([math.inf] * len(self.sample.joints))
        self._fingers.append((math.inf, math.inf))

    def begin(self) -> None:
        """The first tick of a primitive: the bias of the wrench, and contacts that exist already."""
        self._bias = list(self.sample.wrench)
        self._bias_force, self._bias_torque = self._bias[:3], self._bias[3:]
        self._touched_before |= {**self.arm.touches(), **self.arm.arm_touches()}
        self.peak_force_n = self.peak_torque_nm = 0.0

    def refit(self) -> None:
        """The arm has another hand: the tcp, the fingers and what the sensor carries are others from now on."""
        self.sample = self.arm.read()
        self._tcp_of = None
        self.watch()
        self.begin()

    def feel(self, counts: bool = False) -> None:
        """The wrench of this tick; whether it counts for the peaks of the primitive."""
        wrench = self.sample.wrench
        self.force_n = force_n = dist(wrench[:3], self._bias_force)
        self.torque_nm = torque_nm = dist(wrench[3:], self._bias_torque)
        if counts:
            if force_n > self.peak_force_n:
                self.peak_force_n = force_n
            if torque_nm > self.peak_torque_nm:
                self.peak_torque_nm = torque_nm

    def forget_touches(self, but: str | None) -> None:
        """Without a primitive all contacts are new, except this one: it may be intermittent, so it is not measured in
        every tick."""
        self._touched_before = {} if but is None else {but: 0.0}

    @property
    def wrench(self) -> list[float]:
        """The wrench of the present sample minus the bias of the current or last primitive (N, N.m)."""
        return [value - bias for value, bias in zip(self.sample.wrench, self._bias, strict=True)]

    # --- for stop functions ------------------------------------------------------------------------------

    def moment(self, elapsed_s: float, arrived: Finding | None, command: Motion) -> Moment:
        """The input of the checks in this tick. It is one object, filled anew in every tick."""
        moment, sample = self._moment, self.sample
        moment.elapsed_s = elapsed_s
        moment.joints = sample.joints
        moment.velocities = sample.velocities
        moment.wrench = self.wrench
        moment.force_n = self.force_n
        moment.torque_nm = self.torque_nm
        moment.fingers = sample.fingers
        moment.finger_forces = sample.finger_forces
        moment.arrived = arrived
        moment.commanded = command[0]
        return moment

    def _first_moment(self) -> Moment:
        sample = self.sample
        return Moment(
            elapsed_s=0.0,
            joints=sample.joints,
            velocities=sample.velocities,
            wrench=self.wrench,
            force_n=0.0,
            torque_nm=0.0,
            fingers=sample.fingers,
            finger_forces=sample.finger_forces,
            arrived=None,
            tcp=self.tcp,
            touch=self._touch,
            commanded=sample.joints,
            commanded_tcp=lambda: self.arm.tcp_pose(self._moment.commanded),
            tcp_speed_m_s=self._tcp_speed_m_s,
            arm_touch=self._arm_touch,
            near=lambda within_m: self.arm.near(within_m),
        )

    def tcp(self) -> Array:
        """Pose of the tcp in this tick, computed once."""
        if self._tcp_of is not self.sample:
            self._tcp_of, self._tcp_pose = self.sample, self.arm.tcp_pose(self.sample.joints)
        return self._tcp_pose

    def _tcp_speed_m_s(self) -> float:
        """Mean speed of the tcp over the window."""
        before = self.arm.tcp_pose(self._joints[0])
        return geometry.distance(before, self.tcp()) / (max(1, len(self._joints) - 1) * TICK_S)

    def _touch(self) -> str:
        touches = self.arm.touches()
        return self._new_touch(touches) if touches else ""

    def _arm_touch(self) -> str:
        touches = self.arm.arm_touches()
        return self._new_touch(touches) if touches else ""

    def _new_touch(self, touches: Mapping[str, float]) -> str:
        """A contact, as text, or ''. A contact from before the start counts only if its force has grown: otherwise the
        arm could never move away from an obstacle."""
        before = self._touched_before
        for words, force_n in touches.items():
            if force_n > before.get(words, -LEAN_N) + LEAN_N:
                return words
        return ""

    # --- rest --------------------------------------------------------------------------------------------

    def joints_rest(self) -> bool:
        return _spread(self._joints) <= REST_RAD

    def fingers_rest(self) -> bool:
        return _spread(self._fingers) <= REST_M

    def farthest(self, joints: Sequence[float]) -> tuple[int, float]:
        """(joint, distance in rad or m) of the joint that is farthest from these."""
        off = [abs(a - b) for a, b in zip(self.sample.joints, joints, strict=True)]
        joint = max(range(len(off)), key=off.__getitem__)
        return joint, off[joint]

    def off(self, joints: Sequence[float]) -> float:
        """The greatest distance of a joint from these (rad)."""
        return max(abs(a - b) for a, b in zip(self.sample.joints, joints, strict=True))

    @property
    def width_m(self) -> float:
        return sum(self.sample.fingers)

    @property
    def grip_n(self) -> float:
        """Force of the finger that presses less."""
        return min(self.sample.finger_forces)


def _spread(rows: Iterable[Sequence[float]]) -> float:
    """The greatest distance between any two values of one column."""
    return max(max(column) - min(column) for column in zip(*rows, strict=True))
