"""The restart policy: whether and when a dead process is started again. Pure: times are arguments.

A process that ran for a while is restarted at once, any number of times. A process that dies repeatedly soon after its
start is in a crash loop. Its delay doubles up to a maximum, so it takes little processor time and still returns soon
after the fault. A process that was never ready in many starts is given up. A process that was ready once is never given
up, because its fault (a full disk) can pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec


class Death(msgspec.Struct, frozen=True):
    at_s: float
    was_ready: bool
    lived_s: float = 0.0  # time since its start or, if ready, since then


@dataclass(frozen=True)
class Policy:
    within_s: float = 30.0  # older deaths are ignored
    short_s: float = 0.5  # a shorter life counts as short
    spared: int = 3  # number of short lives without delay: a job that kills its workers is refused after three
    first_delay_s: float = 0.1
    longest_delay_s: float = 5.0
    unready_deaths: int = 10  # given up after this many deaths without ever being ready


DEFAULT = Policy()


def delay_s(policy: Policy, deaths: Sequence[Death], was_ready: bool) -> float | None:
    """Delay (s) from the last of `deaths` (oldest first) to the next start; None = give up.

    `was_ready`: it was ready at any time, including lives that `deaths` no longer contains.
    """
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
