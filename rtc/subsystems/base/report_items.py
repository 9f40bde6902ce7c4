"""What a REPORT clause may request of an arm. Pure.

The subsystem measures the items; all other processes pass the reading on unread. Installed packages add items by an
entry point of the group `rtc.report_items`: NAME = module:function

    function(arm: ArmState) -> numbers, texts, lists or maps of them        in SI units

It is called at the end of a primitive and for each report during it, in the loop of the MCM: it must take microseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from rtc.plugins import registry
from rtc.protocol.outcomes import Measured
from rtc.spatial.geometry import Array

STANDARD = ("POSE", "FORCES", "JOINTS")


class ArmState(Protocol):
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

    peak_force_n: float  # of the primitive
    peak_torque_nm: float

    def tcp(self) -> Array: ...  # [x y z qx qy qz qw], m, world axes


def known() -> list[str]:
    """All items of this installation."""
    return [*STANDARD, *registry.installed(registry.REPORT_ITEMS)]


def reading(items: Sequence[str], arm: str, state: ArmState, *, ended: bool) -> Measured:
    """The values of these items. `ended`: with the peaks of the primitive."""
    forces, peaks = "FORCES" in items, "FORCES" in items and ended
    added = registry.installed(registry.REPORT_ITEMS)
    return Measured(
        arm=arm,
        tcp_pose=state.tcp().tolist() if "POSE" in items else None,
        joints=state.joints if "JOINTS" in items else None,
        slides=state.slides if "JOINTS" in items else [],
        wrench=state.wrench if forces else None,
        peak_force_n=state.peak_force_n if peaks else None,
        peak_torque_nm=state.peak_torque_nm if peaks else None,
        others={name: _value(added[name], state) for name in items if name in added},
    )


def _value(measure: Any, state: ArmState) -> Any:
    try:
        return measure(state)
    except Exception as error:  # code of others must not stop the arms
        return f"not measured: {type(error).__name__}: {error}"
