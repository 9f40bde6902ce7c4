"""Whether a process that has died is started again, and when. Pure: the times are arguments.

One that has been at work for a while is started again at once, however often that happens: a killed process costs
nobody more than its start. One that dies again and again soon after its start is in a crash loop: it waits, twice as
long each time up to a longest, so that it takes little from the others, and is back soon after its trouble is over. One
that was never ready, in many starts, is given up; what has been ready once is not: it can start, and what keeps it from
it (a full disk) may pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec


class Death(msgspec.Struct, frozen=True):
    at_s: float
    was_ready: bool
    lived_s: float = 0.0  # since it was ready


@dataclass(frozen=True)
class Policy:
    within_s: float = 30.0  # deaths longer ago are forgotten
    short_s: float = 0.5  # a life shorter than this is a short one
    spared: int = 3  # that many short lives are nobody's fault: a job that kills whoever does it is refused after three
    first_delay_s: float = 0.1
    longest_delay_s: float = 5.0
    unready_deaths: int = 10  # this many without ever having been ready: given up


DEFAULT = Policy()


def delay_s(policy: Policy, deaths: Sequence[Death], was_ready: bool) -> float | None:
    """How long to wait after the last of `deaths` (the oldest first) before the next start; None = give up.
    `was_ready`: in any of its lives, also those that `deaths` no longer holds."""
    last = deaths[-1]
    if not _short(policy, last):
        return 0.0
    if len(deaths) >= policy.unready_deaths and not was_ready:
        return None
    short = sum(_short(policy, d) for d in deaths if last.at_s - d.at_s <= policy.within_s)
    loop = short - (policy.spared if last.was_ready else 0)
    return 0.0 if loop <= 0 else min(policy.longest_delay_s, policy.first_delay_s * 2.0 ** (loop - 1))


def _short(policy: Policy, death: Death) -> bool:
    return not death.was_ready or death.lived_s < policy.short_s
