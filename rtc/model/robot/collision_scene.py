"""The state of the world for a collision check: poses, held objects, distances to keep, permitted contacts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import msgspec

from rtc.spatial.geometry import Floats


@dataclass(frozen=True, eq=False)
class Held:
    """A held object: the arm, and the object's pose in the axes of that arm's tcp."""

    arm: str
    pose: Floats


@dataclass(frozen=True, eq=False)
class AttachedBody:
    """A held object with a hinge. It turns to where a point of it is nearest to the tcp of the arm that holds it."""

    arm: str
    home: Floats  # pose at angle 0, world
    axis: Floats  # unit vector, object's axes
    range_rad: tuple[float, float]  # its stops
    point: Floats  # m, object's axes


class Scene(msgspec.Struct, frozen=True, eq=False):
    """The state of the world for a check. A name is an owner (RACK-1) or a part of one (RACK-1 floor)."""

    poses: Mapping[str, Floats] = {}  # of seats and objects, world; others as in the cell
    held: Mapping[str, Held] = {}  # by object
    attached: Mapping[str, AttachedBody] = {}  # by object
    openings_m: Mapping[str, float] = {}  # of the hands, by arm; default: fully open
    ignore: Iterable[tuple[str, str]] = ()  # pairs that may touch
    clearance_m: float = 0.0  # minimum distance of arms and held objects from others; of a held object from its arm too
    pose_tolerance_m: Mapping[str, float] = {}  # bodies that may be this far from their pose here
    near: Iterable[str] = ()  # bodies exempt from both, but not from contact
    close: Mapping[tuple[str, str], float] = {}  # pairs of pieces with a smaller clearance
    arms_apart_m: float = 0.0  # minimum distance of two arms from each other, with what they hold; without exemption
    keep_out: Iterable[str] = ()  # regions that count as solid
    moving: str = ""  # the arm to check, pairs without it are ignored; empty: all arms


AS_BUILT = Scene()


def in_hands(scene: Scene) -> tuple[tuple[str, str], ...]:
    """(object, arm) of all objects that move with a hand."""
    return (
        *((name, held.arm) for name, held in scene.held.items()),
        *((n, one.arm) for n, one in scene.attached.items()),
    )


def same_places(before: Scene, scene: Scene) -> bool:
    """Whether all bodies are where they were, so that none has to be placed again."""
    same = scene.poses is before.poses and scene.held is before.held and scene.openings_m is before.openings_m
    return same and not before.attached
