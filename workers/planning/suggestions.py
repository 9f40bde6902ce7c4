"""Parts of the cell by name, and the refusal of an unknown name, which lists the known and the nearest ones."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from rtc.model.cells import parts
from rtc.protocol.causes import UnknownName
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.spelling import did_you_mean, nearest


def unknown(what: str, name: str, known: Iterable[str], where: str = "", of: str = "") -> Refused:
    """A refusal with reason NAME. `expected` lists all known names, `nearest` those like the unknown one.

    `of`: the body whose part is named."""
    names = sorted(set(known))
    near = nearest(name, names)
    message = (f"{of} has no {what} {name}" if of else f"there is no {what} {name}") + (
        "" if names else "; there are none at all"
    )
    clears = did_you_mean(near) or ("use one of the names expected" if names else "")
    cause = UnknownName(what=what, name=name, of=of)
    return Refused.because(
        RefusalReason.NAME, message, where=where, nearest=near, expected=names, clears=clears, cause=cause
    )


Part = TypeVar("Part", parts.Arm, parts.Camera, parts.Object, parts.Seat, parts.GraspPoint)


def part(choices: Iterable[Part], name: str, what: str, of: str = "") -> Part:
    """The part with this name. Raises Refused if there is none."""
    known = {one.name: one for one in choices}
    if name not in known:
        raise unknown(what, name, known, of=of)
    return known[name]
