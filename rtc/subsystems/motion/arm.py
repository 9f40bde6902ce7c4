"""The interface between the executor and any arm, real or simulated.

Conventions for every arm. Joints: URDF order (rad). Wrench: [Fx Fy Fz Tx Ty Tz] (N, N.m) exerted by the environment ON
the hand, in tool axes, about the tcp, as the sensor reads it (bias included). Fingers: travel of each from the middle
of the hand (m), pressing force >= 0 (N). This module must not know how an arm moves or what a primitive is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import msgspec

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import SLIDE_MARGIN, ArmModel
from rtc.protocol.primitive import ControlLaw
from rtc.spatial.geometry import Array

TICK_S = 0.001  # period of the servo and of the simulation

Motion = tuple[list[float], list[float], list[float]]  # joints (rad), velocities, accelerations


class Near(NamedTuple):
    """A body that is near to the arm, or to what it holds."""

    distance_m: float  # below 0: how deep they are in one another
    point: Sequence[float]  # the nearest one of the body (m, world)
    link: str  # of the arm, or what its hand holds
    body: str  # its owner, or a part of it
    away: Sequence[float]  # unit vector from the body to the arm (world)
    joints: tuple[int, int]  # the first joint that moves the one against the other, and the first that does not


class Sample(msgspec.Struct, gc=False):
    """All measurements of one arm in one tick."""

    joints: list[float]
    velocities: list[float]  # rad/s
    wrench: list[float]
    fingers: tuple[float, float]  # m from the middle; the opening is their sum
    finger_speeds: tuple[float, float]  # m/s, opening is positive
    finger_forces: tuple[float, float]  # N, pressed towards the middle


class HandCommand(msgspec.Struct, frozen=True):
    """Bring the opening to `width_m` at `speed_m_s`, with at most `force_n`; valid until the next command."""

    width_m: float
    force_n: float
    speed_m_s: float


class SpindleCommand(msgspec.Struct, frozen=True):
    """Turn the spindle of a held driver by `turn_rad` (positive: right-handed about the axis out of the tool)."""

    turn_rad: float
    speed_rad_s: float
    torque_nm: float  # at most; the spindle stalls at it


class SpindleState(msgspec.Struct, frozen=True):
    turned_rad: float = 0.0  # since its command


class ArmState(msgspec.Struct):
    """The state of an arm that survives its controller: brakes hold the joints, the hand keeps its grip."""

    joints: list[float]
    fingers: tuple[float, float]
    hand: HandCommand
    opening_m: float  # present setpoint of the hand servo, on its way to `hand`
    coupled: str = ""  # the hand in its coupler


class CellState(msgspec.Struct):
    """The surviving state of a whole simulated cell."""

    arms: dict[str, ArmState]
    poses: dict[str, list[float]]  # of objects and seats, world frame
    carried: dict[str, tuple[str, list[float]]] = {}  # object -> (arm, pose in tcp axes); kinematic arms only


class Traits(msgspec.Struct, frozen=True, kw_only=True):
    """Constant properties of an arm: names, limits, hand."""

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
    slides: list[bool] = []  # by joint; one that slides has m, m/s, m/s^2
    hand: str | None = None  # in its coupler; empty: none; None: it has no coupler
    rigid: bool = False  # it neither complies with a force nor turns a spindle

    def margins(self, margin_rad: float) -> list[float]:
        """By joint: the distance from its limits (rad, m) that this margin means."""
        slides = self.slides or [False] * len(self.lower)
        return [margin_rad * (SLIDE_MARGIN if sliding else 1.0) for sliding in slides]

    @staticmethod
    def of(cell: Cell, name: str, hand: str = "") -> Traits:
        """The traits of an arm of a cell. `hand`: in its coupler; the cell has the arm with it."""
        spec, model = cell.arm(name), ArmModel.of(cell, name)
        limits = model.limits
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
            slides=model.slides,
            hand=hand if spec.hands else None,
        )


class ArmInterface(Protocol):
    """One arm with its hand. Call `read` once per tick, then `follow`; a command stays valid until the next."""

    traits: Traits

    def read(self) -> Sample:
        """The present sensor values."""

    def follow(self, motion: Motion) -> None:
        """Command the present motion state: the one that an exact arm would have in this tick."""

    def brake(self, on: bool) -> None:
        """Hold all joints, and the fingers of a hand that grips nothing, by brakes instead of servos; or let go."""

    def use_law(self, law: ControlLaw) -> None:
        """Set the control law. Raises ValueError if it is unknown or one of its figures is out of range."""

    def feel(self, wrench: list[float]) -> None:
        """The wrench of this tick minus its bias; called before each `follow` under a compliant law."""

    def command_hand(self, command: HandCommand) -> None: ...

    def drive_spindle(self, command: SpindleCommand | None) -> None:
        """Turn the spindle of the driver in the hand; None stops it. Raises ValueError if the hand holds none, or the
        driver cannot do it."""

    def spindle(self) -> SpindleState: ...

    def couple(self, hand: str) -> str:
        """Lock this hand, or let go of the present one (empty). Returns why it is not locked, or ''. From then on the
        arm is the one with that hand: traits, tcp, fingers, sensor."""

    def tcp_pose(self, joints: Sequence[float]) -> Array:
        """Pose of the tcp at these joint positions (rad), world frame."""

    def jacobian(self, joints: Sequence[float]) -> Array:
        """6 x n: velocity of the tcp [m/s, rad/s] in world axes per joint velocity."""

    def fault(self) -> str:
        """How its control law has failed, since it was set; or ''."""

    def untouched(self) -> bool:
        """Whether `touches` and `arm_touches` are empty."""

    def touches(self) -> Mapping[str, float]:
        """Contacts of the arm's links (without palm and fingers): "LINK touches BODY" -> normal force (N)."""

    def arm_touches(self) -> Mapping[str, float]:
        """Contacts of the arm or its hand with other arms: "LINK touches ARM LINK" -> normal force (N)."""

    def near(self, within_m: float) -> Sequence[Near]:
        """Bodies within a distance of the arm's links, its hand, or what its fingers hold."""


class Simulation(Protocol):
    """A cell with its arms: can be stepped, observed and disturbed. Only the test bench reads the true state."""

    cell: Cell

    @property
    def arms(self) -> Mapping[str, ArmInterface]: ...

    def step(self) -> None:
        """Advance by one tick."""

    def truth(self) -> dict[str, dict[str, list[float]]]:
        """The true state: poses, velocities of every object; tcp, joints, fingers of every arm; tight_nm of every bolt,
        where there is physics."""

    def held(self) -> dict[str, list[str]]:
        """Arm -> objects between its pressing fingers."""

    def state(self) -> CellState:
        """The state that survives the controller."""

    def restore(self, state: CellState) -> None:
        """Restore a saved state, at rest."""

    def displace(self, name: str, offset: Sequence[float]) -> str:
        """Move an object and its seat, or a seat (x y z roll pitch yaw; m, rad). Returns why it is refused, or ''."""

    def stick(self, arm: str, joint: int, stuck: bool) -> None:
        """Let a joint of an arm be stuck, or free again."""

    def jam(self, seat: str, jammed: bool) -> None:
        """Let a module in a seat, or that comes near its place there, be wedged, or free again."""

    def blunt(self, seat: str, blunted: bool) -> str:
        """Take away the lips of a seat, or put them back. Returns the reason of a refusal, or ''."""

    def strip(self, bolt: str, stripped: bool = True) -> str:
        """Strip a bolt, so that it turns without effect, or mend it. Returns the reason of a refusal, or ''."""

    def change_physics(self, mass: float, friction: float) -> str:
        """Scale masses and pad friction relative to the cell file. Returns the reason of a refusal, or ''."""
