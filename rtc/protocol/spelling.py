"""Fuzzy matching: the known words that a misspelt word may stand for, by edit distance.

It compares letters only. All refusals of an unknown name use it and its words.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

MAX_NEAREST = 3


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """The problem text for an unknown name: the known ones, and those that it may stand for."""
    names = sorted(set(known))
    text = f"there is no {kind} {name}; there {'is' if len(names) == 1 else 'are'} {', '.join(names) or 'none'}"
    return "; ".join(filter(None, (text, did_you_mean(nearest(name, names)))))


def did_you_mean(near: Iterable[str]) -> str:
    """The question for the nearest names; empty without any."""
    words = " or ".join(near)
    return words and f"did you mean {words}?"


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """The known names that this one may misspell; else those that it abbreviates (RACK for RACK-1)."""
    names = sorted(set(known))
    return nearest_words(name, names) or [n for n in names if name and n.startswith(name)][:MAX_NEAREST]


def is_next_number(name: str, known: Iterable[str]) -> bool:
    """Whether a name differs from a known one in a number only: SLOT-2 is another name than SLOT-1, and no slip."""
    return re.sub("[0-9]+", "0", name) in {re.sub("[0-9]+", "0", other) for other in known}


def nearest_words(written: str, known: Iterable[str]) -> list[str]:
    """The known words at the least edit distance, at most MAX_NEAREST, sorted; empty if that exceeds the allowance."""
    allowed = max_edit_distance(written)
    near: dict[int, list[str]] = {}
    for word in known:
        if abs(len(word) - len(written)) <= allowed:
            near.setdefault(edit_distance(written, word), []).append(word)
    fewest = min(near, default=allowed + 1)
    return sorted(near[fewest])[:MAX_NEAREST] if fewest <= allowed else []


def max_edit_distance(written: str) -> int:
    """The greatest edit distance for a word of this length. It leaves at least one letter right."""
    return min(len(written) - 1, 1 if len(written) < 5 else 2 if len(written) < 9 else 3)


def edit_distance(written: str, meant: str) -> int:
    """The edit distance (optimal string alignment): omitted, added, changed and transposed letters."""
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
