"""Test bench <-> simulator: not available from real subsystems."""

from __future__ import annotations

from typing import Annotated

import msgspec

from rtc.protocol.faults import AnyFault
from rtc.protocol.messages.shared import Message, Name


class SimTruth(Message, frozen=True, kw_only=True):
    request: Name


class SimTruthReply(Message, frozen=True, kw_only=True):
    request: str
    sim_s: float
    poses: dict[str, list[float]]  # every object of the cell, world frame
    velocities: dict[str, list[float]]  # linear, angular
    tcp: dict[str, list[float]]
    joints: dict[str, list[float]]
    fingers: dict[str, list[float]]  # the two finger joints, m
    held: dict[str, list[str]]  # arm -> objects that both its fingers press on
    seats: dict[str, list[float]] = {}  # every seat of the cell, world frame
    blind: list[str] = []  # cameras whose pictures are black
    tight_nm: dict[str, float] = {}  # bolt -> torque to which it was tightened; 0: not; without physics, no bolt
    at_s: float = 0.0  # when it was so, by the clock of this machine; 0: not stated


class SimDisplace(Message, frozen=True, kw_only=True):
    """Move an object and its seat in the simulator only: this makes a belief error."""

    request: Name
    object: Name
    offset: list[float]  # x y z roll pitch yaw: m, rad; world axes about the object's origin


class SimFactors(Message, frozen=True, kw_only=True):
    """Scale the mass of all movable objects and the friction of all finger pads in the simulator only. Factors of the
    cell's values; the last message counts."""

    request: Name
    mass: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    friction: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0


class SimInject(Message, frozen=True, kw_only=True):
    """Inject a fault; it replaces an active one of the same name."""

    request: Name
    fault: AnyFault


class SimUndo(Message, frozen=True, kw_only=True):
    """Undo an injected fault by its name, such as "stick RIGHT-ARM joint_3", or all of them (ALL)."""

    request: Name
    fault: Name


class SimDone(Message, frozen=True, kw_only=True):
    request: str
    error: str = ""
    note: str = ""
    active: list[str] = []  # injected faults, in words


ToSim = SimTruth | SimDisplace | SimFactors | SimInject | SimUndo
FromSim = SimTruthReply | SimDone
