"""Faults that the simulator can inject, for users and tests. Pure. No real subsystem knows them.

Each has a `name`: injecting a fault of the same name replaces it, and the name undoes it. Values are checked by the
simulator, which knows the cell.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

Word = Annotated[str, msgspec.Meta(max_length=200)]  # a name of the cell


class Fault(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    @property
    def name(self) -> str:
        raise NotImplementedError

    @property
    def words(self) -> str:
        """The name with its figures."""
        return self.name


class Displaced(Fault, frozen=True, kw_only=True, tag="displaced"):
    """An object, with the seat it sits in, is elsewhere than the world database states."""

    object: Word
    offset: list[float]  # x y z (m) roll pitch yaw (rad), world axes, about the object's origin

    @property
    def name(self) -> str:
        return f"displace {self.object}"

    @property
    def words(self) -> str:
        return f"{self.name} by {', '.join(f'{x:g}' for x in self.offset[:3])} m, {_figures(self.offset[3:])} rad"


class StuckJoint(Fault, frozen=True, kw_only=True, tag="stuck-joint"):
    """A joint of an arm does not move."""

    arm: Word
    joint: Word

    @property
    def name(self) -> str:
        return f"stick {self.arm} {self.joint}"


class FalseSensor(Fault, frozen=True, kw_only=True, tag="false-sensor"):
    """The wrist sensor of an arm reads too much, or always the same."""

    arm: Word
    offset: list[float] | None = None  # wrench that it reads too much (N, N.m, tool axes); None: the reading is frozen

    @property
    def name(self) -> str:
        return f"sensor {self.arm}"

    @property
    def words(self) -> str:
        return f"{self.name} {'frozen' if self.offset is None else f'offset by {_figures(self.offset)} N, N.m'}"


class JammedSeat(Fault, frozen=True, kw_only=True, tag="jammed-seat"):
    """A module in the seat, or that comes near its place there, is wedged."""

    seat: Word

    @property
    def name(self) -> str:
        return f"jam {self.seat}"


class StrippedBolt(Fault, frozen=True, kw_only=True, tag="stripped-bolt"):
    """A bolt turns without moving along its axis."""

    bolt: Word

    @property
    def name(self) -> str:
        return f"strip {self.bolt}"


class FailedHand(Fault, frozen=True, kw_only=True, tag="failed-hand"):
    """The hand of an arm opens, drops what it holds, and obeys no command."""

    arm: Word

    @property
    def name(self) -> str:
        return f"drop {self.arm}"


class BlindCamera(Fault, frozen=True, kw_only=True, tag="blind-camera"):
    """The pictures of a camera are black."""

    camera: Word

    @property
    def name(self) -> str:
        return f"blind {self.camera}"


class SlowLoop(Fault, frozen=True, kw_only=True, tag="slow-loop"):
    """Every tick of the servo loop takes longer."""

    tick_s: float

    @property
    def name(self) -> str:
        return "slow"

    @property
    def words(self) -> str:
        return f"{self.name} by {1e3 * self.tick_s:g} ms per tick"


AnyFault = Displaced | StuckJoint | FalseSensor | JammedSeat | StrippedBolt | FailedHand | BlindCamera | SlowLoop


def _figures(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
