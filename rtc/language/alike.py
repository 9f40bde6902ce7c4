"""Which known words a mistyped one may have been meant for. Knows letters only."""

from __future__ import annotations

from collections.abc import Iterable

MAX_NEAREST = 3


def nearest_words(written: str, known: Iterable[str]) -> list[str]:
    """The known words with the fewest slips of the finger, if these are few enough for the word's length."""
    allowed = slips_allowed(written)
    near: dict[int, list[str]] = {}
    for word in known:
        if abs(len(word) - len(written)) <= allowed:
            near.setdefault(slips(written, word), []).append(word)
    fewest = min(near, default=allowed + 1)
    return sorted(near[fewest])[:MAX_NEAREST] if fewest <= allowed else []


def slips_allowed(written: str) -> int:
    """So few that at least one letter is right."""
    return min(len(written) - 1, 1 if len(written) < 5 else 2 if len(written) < 9 else 3)


def slips(written: str, meant: str) -> int:
    """How often a letter was left out, added, changed, or swapped with the next one."""
    before: list[int] = []
    last = list(range(len(meant) + 1))
    for i, w in enumerate(written, 1):
        row = [i]
        for j, m in enumerate(meant, 1):
            cost = min(last[j] + 1, row[j - 1] + 1, last[j - 1] + (w != m))
            if i > 1 and j > 1 and w == meant[j - 2] and written[i - 2] == m:
                cost = min(cost, before[j - 2] + 1)
            row.append(cost)
        before, last = last, row
    return last[-1]
