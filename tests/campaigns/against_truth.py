"""What a cluster believes, against the simulator's truth: valid facts that are wrong, or outside their own spread.

A pose is wrong if it is off by more than 5 mm or 2 degrees beyond the spread that it states. A bolt is wrong if it is
half a turn farther in or out, or if it is believed loose and is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from rtc.protocol.messages import Fact, Validity
from rtc.spatial import geometry
from rtc.spatial.geometry import Floats
from rtc.world.model import LOOSE
from rtc.world.spread import EXACT, in_words

WRONG_M, WRONG_RAD = 0.005, math.radians(2.0)
BEYOND_M, BEYOND_RAD = 1e-4, 1e-3  # a truth this far outside a spread is a matter of rounding
JOINTS_RAD = math.radians(0.5)
WIDTH_M = 0.003
TURNS = 0.5
SEATED_M = 0.03  # an object this far from its seat is not in it


class Judgement(NamedTuple):
    """Valid facts that disagree with the truth, as text."""

    checked: int
    wrong: list[str]
    outside: list[str]


def within(errors: Sequence[float], spread: Sequence[float]) -> bool:
    """Whether errors x y z roll pitch yaw (m, rad) are within a spread."""
    room = [BEYOND_M] * 3 + [BEYOND_RAD] * 3
    return all(abs(error) <= most + more for error, most, more in zip(errors, spread, room, strict=True))


def judge(facts: Iterable[Fact], truth: Mapping[str, Any]) -> Judgement:
    """`truth`: poses, seats, joints, fingers, tcp and held of one moment, at which the arms rest. It may have `turns`:
    bolt -> the turns by which it is out, and all its turns."""
    facts = [fact for fact in facts if fact.validity is Validity.VALID]
    holders = {fact.key.rpartition(".")[0]: fact.value for fact in facts if fact.key.endswith(".held_by")}
    wrong, outside, checked = [], [], 0
    for fact in facts:
        name, _, attribute = fact.key.rpartition(".")
        if attribute in ("frame", "grasp"):
            true = _true_pose(name, attribute, holders, truth)
            if fact.value is None or true is None:
                continue
            off = geometry.relative(fact.value, true)
            errors = [*off[:3].tolist(), *geometry.to_rpy(off).tolist()]
            spread = fact.spread or EXACT
            words = _in_words(fact, errors)
            beyond = [max(0.0, abs(error) - most) for error, most in zip(errors, spread, strict=True)]
            if math.hypot(*beyond[:3]) > WRONG_M or max(beyond[3:]) > WRONG_RAD:
                wrong.append(words)
            if fact.spread is not None and not within(errors, spread):
                outside.append(words)
        elif attribute == "seat" and holders.get(name):
            continue  # of a held object: the slot that it is in or leaves
        elif found := _wrong_value(name, attribute, fact.value, truth):
            wrong.append(f"{fact.key} is {fact.value}, in truth {found}, since {fact.source}")
        checked += 1
    return Judgement(checked, wrong, outside)


def _true_pose(name: str, attribute: str, holders: Mapping[str, Any], truth: Mapping[str, Any]) -> Floats | None:
    if attribute == "frame":
        return truth["poses"].get(name) or truth["seats"].get(name)
    arm = holders.get(name)
    return geometry.relative(truth["tcp"][arm], truth["poses"][name]).tolist() if arm else None


def _wrong_value(name: str, attribute: str, value: Any, truth: Mapping[str, Any]) -> str:
    """The true value if the believed one is wrong; else empty."""
    if attribute == "held_by":
        holders = [arm for arm, things in truth["held"].items() if name in things]
        # Of an object in two hands the fact names the one that its grasp is of.
        return "" if value in holders or (not value and not holders) else f"{holders or 'none'}"
    if attribute == "holding":
        things = truth["held"][name]
        return "" if things == ([value] if value else []) else f"{things or 'none'}"
    if attribute == "joints":
        off_rad = max(abs(a - b) for a, b in zip(value, truth["joints"][name], strict=True))
        return f"{math.degrees(off_rad):.2f} deg from it" if off_rad > JOINTS_RAD else ""
    if attribute == "hand_width":
        width_m = sum(truth["fingers"][name])
        return f"{width_m:.4f}" if abs(value - width_m) > WIDTH_M else ""
    if attribute in ("turns", "state") and name in truth.get("turns", {}):
        turns, all_turns = truth["turns"][name]
        believed = value if attribute == "turns" else all_turns if value == LOOSE else turns
        return f"{turns:.1f} turns out" if abs(believed - turns) > TURNS else ""
    if attribute == "seat" and value:
        off_m = geometry.distance(truth["seats"][value], truth["poses"][name])
        return f"{1e3 * off_m:.0f} mm from it" if off_m > SEATED_M else ""
    return ""


def _in_words(fact: Fact, errors: Sequence[float]) -> str:
    x, y, z, roll, pitch, yaw = [*(1e3 * n for n in errors[:3]), *map(math.degrees, errors[3:])]
    return (
        f"{fact.key} off by {x:.1f} {y:.1f} {z:.1f} mm, {roll:.1f} {pitch:.1f} {yaw:.1f} deg "
        f"(stated {in_words(fact.spread) or 'exact'}) since {fact.source}"
    )
