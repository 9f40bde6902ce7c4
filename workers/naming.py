"""Names of a sentence against names that are known: the nearest ones when a name is not."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from rtc.outcomes import Refusal, RefusalReason

MOST_NEAREST = 3


def nearest(name: str, known: Iterable[str], likeness: float = 0.5) -> list[str]:
    """The known names most like this one, likest first. `likeness`: at least so much, of 1 for the same name."""
    return difflib.get_close_matches(name, sorted(set(known)), n=MOST_NEAREST, cutoff=likeness)


def unknown(what: str, name: str, known: Iterable[str], where: str = "") -> Refusal:
    """No such name. The names there are, and those like it, are in `expected` and `nearest`, once."""
    names = sorted(set(known))
    near = nearest(name, names)
    message = f"there is no {what} {name}" + ("" if names else "; there are none at all")
    clears = f"did you mean {' or '.join(near)}?" if near else "use one of the names expected" if names else ""
    return Refusal(reason=RefusalReason.NAME, message=message, where=where, nearest=near, expected=names, clears=clears)
