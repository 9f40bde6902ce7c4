"""What the executor needs of any arm, real or simulated, and nothing else.

Signs, fixed here for every arm: joints in URDF order (rad); the wrench is [Fx Fy Fz Tx Ty Tz] (N, N.m), what the
surroundings exert ON the hand, in tool axes, about the tcp, as the sensor reads it (no bias taken off); each finger
has its own travel from the middle of the hand (m), and presses with a force >= 0 (N). This file must not know how an
arm moves, nor what a primitive is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import msgspec

from rtc.cell import Cell
from rtc.geometry import Array
from rtc.primitive import ControlLaw
from rtc.robot.kinematics import ArmModel

TICK_S = 0.001  # of the servo, and of the simulated world

Motion = tuple[list[float], list[float], list[float]]  # joints (rad), velocities, accelerations


class Sample(msgspec.Struct, gc=False):
    """All that is measured of one arm in one tick."""

    joints: list[float]
    velocities: list[float]  # rad/s
    wrench: list[float]
    fingers: tuple[float, float]  # m from the middle; the opening is their sum
    finger_speeds: tuple[float, float]  # m/s, opening is positive
    finger_forces: tuple[float, float]  # N, pressed towards the middle


class HandCommand(msgspec.Struct, frozen=True):
    """Bring the opening to `width_m` at `speed_m_s`, pressing with at most `force_n`; stays in force until the next."""

    width_m: float
    force_n: float
    speed_m_s: float


class ArmState(msgspec.Struct):
    """What stays as it is when an arm's controller dies: it is braked, and the hand keeps its grip."""

    joints: list[float]
    fingers: tuple[float, float]
    hand: HandCommand
    opening_m: float  # where the hand's servo is on its way to that


class CellState(msgspec.Struct):
    """The same of a whole simulated cell."""

    arms: dict[str, ArmState]
    poses: dict[str, list[float]]  # of objects and seats, world frame
    carried: dict[str, tuple[str, list[float]]] = {}  # object -> arm, pose in tcp axes; where holding is no physics


class Traits(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of an arm that do not change: names, limits, hand."""

    name: str
    joint_names: list[str]
    lower: list[float]  # rad
    upper: list[float]
    velocity: list[float]  # rad/s
    acceleration: list[float]  # rad/s^2; the cell's `acceleration_deg_s2`
    payload_kg: float
    max_opening_m: float
    max_grip_n: float
    hand_speed_m_s: float

    @staticmethod
    def of(cell: Cell, name: str) -> Traits:
        """The traits of an arm of a cell."""
        spec, limits = cell.arm(name), ArmModel.of(cell, name).limits
        return Traits(
            name=name,
            joint_names=list(spec.joints),
            lower=limits.lower.tolist(),
            upper=limits.upper.tolist(),
            velocity=limits.velocity.tolist(),
            acceleration=limits.acceleration.tolist(),
            payload_kg=spec.payload_kg,
            max_opening_m=spec.gripper.max_opening_m,
            max_grip_n=spec.gripper.max_force_n,
            hand_speed_m_s=spec.gripper.speed_m_s,
        )


class Arm(Protocol):
    """One arm with its hand. `read` once per tick, then `follow`; what is not commanded anew stays in force."""

    traits: Traits

    def read(self) -> Sample:
        """What the sensors say now."""

    def follow(self, motion: Motion) -> None:
        """Where to be now: what this tick's sample should have shown, had it been followed exactly."""

    def use_law(self, law: ControlLaw) -> None:
        """How to follow from now on. ValueError, in words, when there is no such law or a gain is out of range."""

    def command_hand(self, command: HandCommand) -> None: ...

    def tcp_pose(self, joints: Sequence[float]) -> Array:
        """Where the tcp is with these joints, world frame."""

    def touches(self) -> Mapping[str, float]:
        """What links of the arm (not palm, not fingers) touch: "LINK touches BODY" -> force pressed (N)."""


class Simulation(Protocol):
    """A cell with arms in it, that can be stepped, looked at and tampered with. Only the test bench asks for truth."""

    @property
    def arms(self) -> Mapping[str, Arm]: ...

    def step(self) -> None:
        """One tick of the world."""

    def truth(self) -> dict[str, dict[str, list[float]]]:
        """poses, velocities of every object; tcp, joints, fingers of every arm."""

    def held(self) -> dict[str, list[str]]:
        """Arm -> objects that both its fingers press on."""

    def state(self) -> CellState:
        """All that stays as it is when the controller dies."""

    def restore(self, state: CellState) -> None:
        """Be as it was, at rest."""

    def displace(self, name: str, offset: Sequence[float]) -> str:
        """Move an object with the seat it sits in (x y z roll pitch yaw). Returns why not, or ''."""

    def change_physics(self, mass: float, friction: float) -> str:
        """Things weigh, and pads rub, so many times what the cell says. Returns why not, or ''."""
