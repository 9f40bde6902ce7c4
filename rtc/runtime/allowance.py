"""An allowance per second: the limit on what one peer, or all of them, may cause. Pure: the time is an argument."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable


class Allowance:
    """At most `per_s` in each second, for each user. A second begins with the first use after the one before."""

    def __init__(self, per_s: int) -> None:
        self._per_s, self._ends_s = per_s, 0.0
        self._used = Counter[Hashable]()  # by user, in this second

    def take(self, now_s: float, user: Hashable = None, cost: int = 1) -> bool:
        """Count a use, also one that is not allowed. True if it is within the allowance."""
        if now_s >= self._ends_s:
            self._ends_s = now_s + 1.0
            self._used.clear()
        self._used[user] += cost
        return self._used[user] <= self._per_s
