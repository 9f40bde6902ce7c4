"""What a REPORT clause may request of an arm. Pure.

The subsystem measures the items; all other processes pass the reading on unread. Installed packages add items by an
entry point of the group `rtc.report_items`: NAME = module:function

    function(arm: ArmState) -> numbers, texts, lists or maps of them        in SI units

It is called at the end of a primitive and for each report during it. The MCM has it called in a process of its own
(`item_process`), whose answer it awaits for some milliseconds, and no longer.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import msgspec

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.protocol.outcomes import Measured
from rtc.spatial.geometry import Array

STANDARD = ("POSE", "FORCES", "JOINTS")
MOST_PARTS = 2_000  # numbers and characters of one value
MOST_DEEP = 20  # lists and maps within each other
MOST_INTEGER = 1 << 63  # beyond it no message can have one


class MeasuredArm(Protocol):
    """What an arm measures now: see `rtc.subsystems.motion.observation.Observation`."""

    @property
    def joints(self) -> list[float]: ...  # rad; m for those of `slides`
    @property
    def slides(self) -> list[int]: ...
    @property
    def wrench(self) -> list[float]: ...  # [Fx Fy Fz Tx Ty Tz]: N, N.m, tool axes
    @property
    def width_m(self) -> float: ...  # opening of the hand
    @property
    def grip_n(self) -> float: ...
    @property
    def peak_force_n(self) -> float: ...  # of the primitive
    @property
    def peak_torque_nm(self) -> float: ...

    def tcp(self) -> Array | list[float]: ...  # [x y z qx qy qz qw], m, world axes


class ArmSnapshot(msgspec.Struct, kw_only=True):
    """A copy of a `MeasuredArm`: code of a package gets nothing that belongs to an arm."""

    joints: list[float]
    slides: list[int]
    wrench: list[float]
    width_m: float
    grip_n: float
    peak_force_n: float
    peak_torque_nm: float
    pose: list[float]

    def tcp(self) -> list[float]:
        return self.pose

    @staticmethod
    def of(state: MeasuredArm) -> ArmSnapshot:
        return ArmSnapshot(
            joints=[*state.joints],
            slides=[*state.slides],
            wrench=[*state.wrench],
            width_m=state.width_m,
            grip_n=state.grip_n,
            peak_force_n=state.peak_force_n,
            peak_torque_nm=state.peak_torque_nm,
            pose=[*map(float, state.tcp())],
        )


Measure = Callable[[str, ArmSnapshot], Any]  # the value of an item, or words that it could not be measured


def known() -> list[str]:
    """All items of this installation."""
    return [*STANDARD, *sorted(registry.names(registry.REPORT_ITEMS))]


def why_not_loaded(name: str) -> str:
    """Why the package of a known item cannot be used; or ''."""
    return "" if name in STANDARD else registry.why_missing(registry.REPORT_ITEMS, name)


def measured(name: str, state: ArmSnapshot) -> Any:
    """What the function of a package returns, as plain data; words, if it fails."""
    if why := why_not_loaded(name):
        return not_measured(why)
    try:
        with registry.guarded(registry.REPORT_ITEMS, name):
            return plain(registry.installed(registry.REPORT_ITEMS)[name](state))
    except PluginError as error:
        return not_measured(error.problem)


def not_measured(why: str) -> str:
    return f"not measured: {why}"


def reading(
    items: Sequence[str], arm: str, state: MeasuredArm, *, ended: bool, measure: Measure = measured
) -> Measured:
    """The values of these items. `ended`: with the peaks of the primitive."""
    forces, peaks = "FORCES" in items, "FORCES" in items and ended
    added = [name for name in items if name not in STANDARD]
    snapshot = ArmSnapshot.of(state) if added else None
    return Measured(
        arm=arm,
        tcp_pose=[*map(float, state.tcp())] if "POSE" in items else None,
        joints=state.joints if "JOINTS" in items else None,
        slides=state.slides if "JOINTS" in items else [],
        wrench=state.wrench if forces else None,
        peak_force_n=state.peak_force_n if peaks else None,
        peak_torque_nm=state.peak_torque_nm if peaks else None,
        others={name: measure(name, snapshot) for name in added} if snapshot is not None else {},
    )


def plain(value: Any) -> Any:
    """The value as None, truth values, finite numbers, texts, lists and maps with texts as keys, of bounded size.
    Raises TypeError and ValueError for any other."""
    return _plain(value, [MOST_PARTS], MOST_DEEP)


def _plain(value: Any, left: list[int], deeper: int) -> Any:
    """`left`: how many parts the value may still have."""
    kind = type(value)
    if value is None or kind is bool:
        return _counted(value, 1, left)
    if kind is str:
        _counted(value, len(value) + 1, left)
        value.encode()  # a text that is no Unicode cannot be sent
        return value
    if hasattr(kind, "tolist") and hasattr(kind, "size") and deeper:  # of numpy
        if int(value.size) > left[0]:  # before they are made
            _counted(value, int(value.size), left)
        return _plain(value.tolist(), left, deeper - 1)
    if isinstance(value, numbers.Integral):
        if not -MOST_INTEGER <= int(value) < MOST_INTEGER:
            raise ValueError("a whole number has more than 64 bits")
        return _counted(int(value), 1, left)
    if isinstance(value, numbers.Real):
        if not math.isfinite(number := float(value)):
            raise ValueError(f"{number} is not a finite number")
        return _counted(number, 1, left)
    if deeper == 0:
        raise ValueError(f"lists and maps are more than {MOST_DEEP} deep")
    if kind in (list, tuple):
        _counted(value, 1, left)
        return [_plain(part, left, deeper - 1) for part in value]
    if isinstance(value, Mapping):
        _counted(value, 1, left)
        return {_key(key, left): _plain(part, left, deeper - 1) for key, part in value.items()}
    raise TypeError(f"a report cannot contain a {kind.__name__}")


def _key(key: Any, left: list[int]) -> str:
    if type(key) is not str:
        raise TypeError(f"the keys of a map are texts, not {type(key).__name__}")
    return str(_plain(key, left, 0))


def _counted(value: Any, parts: int, left: list[int]) -> Any:
    left[0] -= parts
    if left[0] < 0:
        raise ValueError(f"it has more than {MOST_PARTS} numbers and characters")
    return value
