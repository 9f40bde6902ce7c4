"""A fact of the world in words: centimetres, degrees, the units of each joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rtc.drawing.scene import centimetres, degrees
from rtc.model.cells.cell import Cell
from rtc.model.cells.taught import arm_of
from rtc.protocol.messages import Fact
from rtc.world.spread import in_words

JointUnits = Mapping[str, Sequence[str]]  # arm -> mm or deg of each joint


def shown(value: Any) -> str:
    """A value for people, with at most four decimals."""
    if isinstance(value, list | tuple):
        return "[" + " ".join(shown(item) for item in value) + "]"
    if isinstance(value, float):
        return f"{round(value, 4) + 0.0:g}"  # + 0.0: no minus before a zero
    return "-" if value in (None, "") else str(value)


def units_in(cell: Cell) -> JointUnits:
    return {arm.name: tuple("mm" if isinstance(value, str) else "deg" for value in arm.home_deg) for arm in cell.arms}


def stated(fact: Fact, units: JointUnits) -> str:
    """The value; for a pose also its spread."""
    words = in_words(fact.spread)
    location, _, attribute = fact.key.rpartition(".")
    if attribute in ("joints", "motion") or arm_of(attribute):
        value = JOINTS.get(attribute, joints_in_words)(fact.value, units.get(arm_of(attribute) or location))
    else:
        value = UNITS.get(attribute, shown)(fact.value)
    return f"{value} +- {words}" if words else value


def _pose(value: Any) -> str:
    return f"{centimetres(value)} cm, {degrees(value)} deg" if isinstance(value, list | tuple) else shown(value)


def joints_in_words(value: Any, units: Sequence[str] | None) -> str:
    """90 0 deg; with a joint that slides each has its unit. `units`: of the joints; None: they are not known."""
    if not isinstance(value, list | tuple):
        return shown(value)
    if units is None or len(units) != len(value):
        return f"{shown(value)} (rad, or m of a joint that slides)"
    figures = [1e3 * n if unit == "mm" else math.degrees(n) for n, unit in zip(value, units, strict=True)]
    texts = [f"{round(figure, 2) + 0.0:g}" for figure in figures]
    if "mm" not in units:
        return " ".join(texts) + " deg"
    return ", ".join(f"{text} {unit}" for text, unit in zip(texts, units, strict=True))


def _width(value: Any) -> str:
    return f"{round(100 * value, 2) + 0.0:g} cm" if isinstance(value, float | int) else shown(value)


def _sighting(value: Any) -> str:
    """What a camera saw: the evidence for the frame."""
    if not isinstance(value, dict):
        return shown(value)
    words = f"{' and '.join(value['cameras'])}: tags {shown(value['tags'])[1:-1]} in {value['pictures']} pictures, "
    words += f"{value['error_px']:.2f} px off, +- {1e3 * value['deviation_m']:.1f} mm "
    words += f"{math.degrees(value['deviation_rad']):.2f} deg (1 sigma), {1e3 * value['age_s']:.0f} ms old then"
    return words + (", ambiguous attitude" if value["ambiguous"] else "")


def _motion(value: Any, units: Sequence[str] | None) -> str:
    """Where an arm is going."""
    ago_s, takes_s = value["started_ago_s"], value["time_s"][-1]
    since = "not started yet" if ago_s is None else f"started {ago_s:.1f} s ago"
    return f"to {joints_in_words(value['positions'][-1], units)} in {takes_s:.1f} s, {since} ({value['primitive']})"


#: attribute with joints -> its value for people, with the units of the joints; postures of places have any other name
JOINTS: dict[str, Callable[[Any, Sequence[str] | None], str]] = {"joints": joints_in_words, "motion": _motion}
#: attribute -> its value for people; JSON has m, rad and quaternions
UNITS: dict[str, Callable[[Any], str]] = {
    "frame": _pose,
    "grasp": _pose,
    "hand_width": _width,
    "sighting": _sighting,
    "mass": lambda value: f"{shown(value)} kg",
}
