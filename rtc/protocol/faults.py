"""Faults that the simulator can inject, for users and tests. Pure. No real subsystem knows them.

Each has a `name`: injecting a fault of the same name replaces it, and the name undoes it. Values are checked by the
simulator, which knows the cell.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from rtc.protocol.outcomes import StopReason

Word = Annotated[str, msgspec.Meta(max_length=200)]  # a name of the cell


class Fault(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    verb: ClassVar[str]  # of `rtc inject`

    @property
    def name(self) -> str:
        """The verb and the names of the cell to which it applies."""
        return " ".join([self.verb, *(value for value in msgspec.structs.astuple(self) if isinstance(value, str))])

    @property
    def words(self) -> str:
        """The name with its figures."""
        return self.name


class Displaced(Fault, frozen=True, kw_only=True, tag="displaced"):
    """An object is elsewhere than the world database states, with the seat it sits in, or with what is mounted on it
    and what sits there. Or an empty seat is."""

    verb = "displace"
    object: Word
    offset: list[float]  # x y z (m) roll pitch yaw (rad), world axes, about the object's origin

    @property
    def words(self) -> str:
        return f"{self.name} by {', '.join(f'{x:g}' for x in self.offset[:3])} m, {_figures(self.offset[3:])} rad"


class Drifting(Fault, frozen=True, kw_only=True, tag="drifting"):
    """An object moves by itself, steadily and whatever is in its way, with what moves with a displaced one. In a hand
    it rests."""

    verb = "drift"
    object: Word
    velocity: list[float]  # m/s three times, rad/s three times: world axes, about the object's origin

    @property
    def words(self) -> str:
        return f"{self.name} with {_figures(self.velocity[:3])} m/s, {_figures(self.velocity[3:])} rad/s"


class StuckJoint(Fault, frozen=True, kw_only=True, tag="stuck-joint"):
    """A joint of an arm does not move."""

    verb = "stick"
    arm: Word
    joint: Word


class FalseSensor(Fault, frozen=True, kw_only=True, tag="false-sensor"):
    """The wrist sensor of an arm reads too much, or always the same."""

    verb = "sensor"
    arm: Word
    offset: list[float] | None = None  # wrench that it reads too much (N, N.m, tool axes); None: the reading is frozen

    @property
    def words(self) -> str:
        return f"{self.name} {'frozen' if self.offset is None else f'offset by {_figures(self.offset)} N, N.m'}"


class JammedSeat(Fault, frozen=True, kw_only=True, tag="jammed-seat"):
    """A module in the seat, or that comes near its place there, is wedged."""

    verb = "jam"
    seat: Word


class BluntSeat(Fault, frozen=True, kw_only=True, tag="blunt-seat"):
    """A seat has no lips that guide a module in."""

    verb = "blunt"
    seat: Word


class StrippedBolt(Fault, frozen=True, kw_only=True, tag="stripped-bolt"):
    """A bolt turns without moving along its axis."""

    verb = "strip"
    bolt: Word


class FailedHand(Fault, frozen=True, kw_only=True, tag="failed-hand"):
    """The hand of an arm opens, drops what it holds, and obeys no command."""

    verb = "drop"
    arm: Word


class MisreadHand(Fault, frozen=True, kw_only=True, tag="misread-hand"):
    """The hand of an arm that closes on something reads as closed on nothing, until it opens. This happens once."""

    verb = "misread"
    arm: Word


class WeakHand(Fault, frozen=True, kw_only=True, tag="weak-hand"):
    """The grip of an arm weakens steadily. Each time it closes it has its force again, and then loses it."""

    verb = "weaken"
    arm: Word
    n_s: float  # N/s

    @property
    def words(self) -> str:
        return f"{self.name} by {self.n_s:g} N/s"


class BlindCamera(Fault, frozen=True, kw_only=True, tag="blind-camera"):
    """The pictures of a camera are black."""

    verb = "blind"
    camera: Word


class ForcedEnd(Fault, frozen=True, kw_only=True, tag="forced-end"):
    """The primitive that an arm executes, or its next one, ends at once for a reason. This happens once."""

    verb = "end"
    arm: Word
    reason: StopReason

    @property
    def name(self) -> str:
        return f"{self.verb} {self.arm}"

    @property
    def words(self) -> str:
        return f"{self.name} with {self.reason.value}"


class SlowLoop(Fault, frozen=True, kw_only=True, tag="slow-loop"):
    """Every tick of the servo loop takes longer."""

    verb = "slow"
    tick_s: float

    @property
    def words(self) -> str:
        return f"{self.name} by {1e3 * self.tick_s:g} ms per tick"


AnyFault = (
    Displaced
    | Drifting
    | StuckJoint
    | FalseSensor
    | JammedSeat
    | BluntSeat
    | StrippedBolt
    | FailedHand
    | MisreadHand
    | WeakHand
    | BlindCamera
    | ForcedEnd
    | SlowLoop
)


def _figures(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
