"""Whether a process that has died is started again, and when. Pure: the times are arguments.

One that was at work is started again at once: a killed worker costs nobody more than its start. One that dies before
it was ready waits, twice as long each time, and is given up after a few. Whoever dies too often in all is given up
too: something else is wrong then, and restarting it would only hide that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec


class Death(msgspec.Struct, frozen=True):
    at_s: float
    was_ready: bool


@dataclass(frozen=True)
class Policy:
    within_s: float = 30.0  # deaths longer ago are forgotten
    unready_deaths: int = 5  # this many without ever having been ready: given up
    deaths: int = 20  # this many in all: given up
    first_delay_s: float = 0.1
    longest_delay_s: float = 5.0


DEFAULT = Policy()


def delay_s(policy: Policy, deaths: Sequence[Death]) -> float | None:
    """How long to wait after the last of `deaths` (the oldest first) before the next start; None = give up."""
    now_s = deaths[-1].at_s
    recent = [death for death in deaths if now_s - death.at_s <= policy.within_s]
    unready = sum(not death.was_ready for death in recent)
    if unready >= policy.unready_deaths or len(recent) >= policy.deaths:
        return None
    if deaths[-1].was_ready:
        return 0.0
    return min(policy.longest_delay_s, policy.first_delay_s * 2.0 ** (unready - 1))
