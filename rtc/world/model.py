"""The world model: facts with a value, a validity, a version and a source. Pure.

The key of a fact is LOCATION.attribute (MACS-OLD.frame). A pose fact may have a spread (`rtc.world.spread`). `World` is
one consistent, immutable view of all facts; a newer view or an overlay makes another. The table `ATTRIBUTES` defines
the valid values. This module knows neither the database nor the permissions to write.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec

from rtc.protocol.messages import Fact, Validity, View, WorldChange

if TYPE_CHECKING:
    from rtc.model.cells.cell import Cell

#: attributes that a motion can change
MOVED = frozenset(
    {
        *("joints", "hand_width", "hand_force", "holding", "frame", "seat", "held_by", "grasp", "angle"),
        *("turns", "state", "hand", "mating"),
    }
)
#: those of a held object that change with the motion of its hand
CARRIED = ("frame", "seat", "angle")
#: states of a bolt: tightened; neither tightened nor out; turned out by all its turns, so that it fastens nothing
TIGHT, TURNED, LOOSE = BOLT_STATES = ("TIGHT", "TURNED", "LOOSE")
UNIT_TOLERANCE = 1e-4  # tolerance of the norm of a quaternion
MOST_SPREAD = 100.0  # of a pose, m and rad: a larger one says nothing about where a body of a cell is
MAX_LENGTH = 1000  # of texts, lists and maps in such values
MAX_DEPTH = 8  # maximum nesting in values of attributes without a row in ATTRIBUTES


@dataclass(frozen=True)
class World:
    """One consistent view. `version` increases with each commit; `facts`, by key, must not be modified."""

    version: int = 0
    facts: Mapping[str, Fact] = field(default_factory=dict)

    def get(self, key: str) -> Fact | None:
        return self.facts.get(key)

    def value(self, key: str, default: Any = None) -> Any:
        """The value alone, of any validity; `default` without such a fact."""
        fact = self.facts.get(key)
        return default if fact is None else fact.value

    def updated(self, view: View) -> World:
        """This world with the facts of a view. An older version is from another database: it replaces all."""
        if view.version < self.version:
            return World(view.version, {fact.key: fact for fact in view.facts})
        if not view.facts:
            return self if view.version == self.version else World(view.version, self.facts)
        return World(view.version, {**self.facts, **{fact.key: fact for fact in view.facts}})

    def overlay(self, changes: Iterable[WorldChange], source: str = "overlay", at_s: float = 0.0) -> World:
        """The world after these changes, for hypothesis tests: same version, nothing is stored."""
        facts = dict(self.facts)
        for change in changes:
            facts[change.key] = changed(facts.get(change.key), change, self.version, source, at_s)
        return World(self.version, facts)


def changed(old: Fact | None, change: WorldChange, version: int, source: str, at_s: float) -> Fact:
    """The fact after the change. A change without a value keeps the old one; a doubt does not make it more certain."""
    value, spread, validity = change.value, change.spread, change.validity
    if change.keep_value and old is not None:
        value, spread = old.value, spread or old.spread
        if validity is Validity.SUSPECT and old.validity in (Validity.UNKNOWN, Validity.INVALID):
            validity = old.validity
    return Fact(
        key=change.key, value=value, validity=validity, version=version, source=source, at_s=at_s, spread=spread
    )


def moved_with(facts: Mapping[str, Fact], arms: Collection[str]) -> dict[str, str]:
    """Keys of the facts that the motion of these arms changes -> the arm: its joints, and where it carries things."""
    moved: dict[str, str] = {}
    for arm in arms:
        held = facts.get(f"{arm}.holding")
        keys = [f"{arm}.joints"]
        if held is not None and held.value:
            keys += [f"{held.value}.{attribute}" for attribute in CARRIED]
        moved.update((key, arm) for key in keys if key in facts)
    return moved


def as_changing(facts: Iterable[Fact], changing: Collection[str]) -> list[Fact]:
    """The facts as a reader should see them: those of these keys are changing, if they were valid."""
    marks = {"validity": Validity.CHANGING}
    return [
        msgspec.structs.replace(fact, **marks) if fact.key in changing and fact.validity is Validity.VALID else fact
        for fact in facts
    ]


def location(key: str) -> str:
    """MACS-OLD of MACS-OLD.frame. Leases are for locations."""
    return key.rpartition(".")[0]


def selected(facts: Mapping[str, Fact], keys: Iterable[str] | None, since: int = 0) -> list[Fact]:
    """The facts newer than version `since`, of all or of some keys or locations."""
    if keys is None:
        found: Iterable[Fact] = facts.values()
    else:
        wanted = list(keys)
        known = list(map(facts.get, wanted))
        found = [fact for fact in known if fact is not None]
        if len(found) < len(wanted):
            locations = {key for key, fact in zip(wanted, known, strict=True) if fact is None}
            found = [*found, *(fact for key, fact in facts.items() if location(key) in locations)]
    return [fact for fact in found if fact.version > since] if since else list(found)


def initial_facts(cell: Cell) -> list[WorldChange]:
    """The initial facts: arms at home with open, empty hands, and objects as in the cell file."""
    changes = []
    for arm in cell.arms:
        changes += [
            WorldChange(key=f"{arm.name}.joints", value=list(arm.home_rad)),
            WorldChange(key=f"{arm.name}.hand_width", value=arm.gripper.max_opening_m),
            WorldChange(key=f"{arm.name}.holding", value=""),
        ]
        if arm.hands:
            changes.append(WorldChange(key=f"{arm.name}.hand", value=""))
    for thing in cell.objects:
        changes += [
            WorldChange(
                key=f"{thing.name}.frame",
                value=cell.object_pose(thing.name).tolist(),
                validity=Validity.UNKNOWN if thing.unsurveyed else Validity.VALID,
                spread=thing.surveyed_spread,
            ),
            WorldChange(key=f"{thing.name}.seat", value=thing.seat or ""),
            WorldChange(key=f"{thing.name}.held_by", value=""),
            WorldChange(key=f"{thing.name}.grasp", value=None),
            WorldChange(key=f"{thing.name}.mass", value=thing.mass_kg),
        ]
        if thing.hinge is not None:
            changes.append(WorldChange(key=f"{thing.name}.angle", value=math.radians(thing.hinge.at_deg)))
        if thing.thread is not None:
            changes.append(WorldChange(key=f"{thing.name}.turns", value=0.0))
            changes.append(WorldChange(key=f"{thing.name}.state", value=TIGHT))
    return changes


# --- validity of values -------------------------------------------------------------------------------


def problem(change: WorldChange) -> str:
    """The reason why this change is invalid; empty when it is valid."""
    place, _, attribute = change.key.rpartition(".")
    if not place or not attribute or len(change.key) > 200:
        return f"{change.key!r} is not a key of the form LOCATION.attribute"
    if change.spread is not None and not all(_finite(n) and 0 <= n <= MOST_SPREAD for n in change.spread):
        wanted = f"six numbers from 0 to {MOST_SPREAD:g} (m, rad)"
        return f"the spread of {change.key} must be {wanted}, not {_shown(change.spread)}"
    if change.keep_value:
        return ""
    if change.value is None and change.validity != Validity.VALID:
        return ""  # an unknown fact has no value
    wrong = ATTRIBUTES.get(attribute, _plain)(change.value)
    return wrong and f"{change.key} {wrong}"


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _numbers(value: Any) -> str:
    whole = isinstance(value, list | tuple) and len(value) > 0 and all(_finite(n) for n in value)
    return "" if whole else f"must be a list of finite numbers, not {_shown(value)}"


def _pose(value: Any) -> str:
    if _numbers(value) or len(value) != 7:
        return f"must be a pose of 7 finite numbers [x y z qx qy qz qw], not {_shown(value)}"
    length = math.hypot(*value[3:])
    return "" if abs(length - 1.0) <= UNIT_TOLERANCE else f"must have a unit quaternion, its length is {length:.6g}"


def _pose_or_none(value: Any) -> str:
    return "" if value is None else _pose(value)


def _length(value: Any) -> str:
    return "" if _finite(value) and value >= 0 else f"must be a finite number, not negative, not {_shown(value)}"


def _number(value: Any) -> str:
    return "" if _finite(value) else f"must be a finite number, not {_shown(value)}"


def _text(value: Any) -> str:
    return "" if isinstance(value, str) and len(value) <= 200 else f"must be a name or empty, not {_shown(value)}"


def _plain(value: Any, depth: int = 0) -> str:
    """Problem of a value of an additional attribute: it must be plain, comparable and printable."""
    if value is None or isinstance(value, bool) or _finite(value):
        return ""
    if isinstance(value, str | list | tuple | dict) and len(value) > MAX_LENGTH:
        return f"must have at most {MAX_LENGTH} characters or parts, not {len(value)}"
    if isinstance(value, str):
        return ""
    if isinstance(value, list | tuple | dict) and depth < MAX_DEPTH:
        parts = value.values() if isinstance(value, dict) else value
        return next((wrong for part in parts if (wrong := _plain(part, depth + 1))), "")
    return f"must be plain text, finite numbers, or lists of them, not {_shown(value)}"


def _shown(value: Any) -> str:
    """The beginning of a value, which may be deep or long."""
    return reprlib.repr(value)[:80]


ATTRIBUTES: dict[str, Callable[[Any], str]] = {
    "joints": _numbers,  # rad
    "hand_width": _length,  # m
    "hand_force": _length,  # N, when the hand had closed on something
    "holding": _text,  # object
    "hand": _text,  # in the coupler of an arm; empty: none
    "frame": _pose,  # world frame
    "seat": _text,
    "held_by": _text,  # arm
    "grasp": _pose_or_none,  # of the object's frame, in tcp axes, while held
    "mass": _length,  # kg
    "angle": _number,  # about the hinge of the object, rad
    "turns": _number,  # by which a bolt is turned out of its tight place
}
