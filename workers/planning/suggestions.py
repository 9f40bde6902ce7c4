"""Suggestions for an unknown name: the refusal that lists the known names and the nearest ones."""

from __future__ import annotations

from collections.abc import Iterable

from rtc.language.alike import MAX_NEAREST, nearest_words
from rtc.protocol.outcomes import RefusalReason, Refused


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """The known names that this one may misspell; else those that it abbreviates (RACK for RACK-1)."""
    names = sorted(set(known))
    return nearest_words(name, names) or [n for n in names if name and n.startswith(name)][:MAX_NEAREST]


def unknown(what: str, name: str, known: Iterable[str], where: str = "") -> Refused:
    """A refusal with reason NAME. `expected` lists all known names, `nearest` those like the unknown one."""
    names = sorted(set(known))
    near = nearest(name, names)
    message = f"there is no {what} {name}" + ("" if names else "; there are none at all")
    clears = f"did you mean {' or '.join(near)}?" if near else "use one of the names expected" if names else ""
    return Refused.because(RefusalReason.NAME, message, where=where, nearest=near, expected=names, clears=clears)
