"""One period of the simulated MCM, for its process and for everything that plays it in one process."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from rtc.subsystems.motion.arm import Simulation

T = TypeVar("T")


def period(control: Callable[[float], T], simulation: Simulation, now_s: float) -> T:
    """One servo tick, then one simulation step; returns what the tick reports. Halts and orders are obeyed before it.

    A step between order and tick would apply the earlier command under the new control law: a compliant arm that is
    halted would be jerked by what its spring is stretched."""
    reported = control(now_s)
    simulation.step()
    return reported
