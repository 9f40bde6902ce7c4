"""Algorithms that a program names, in the order in which they are asked: rtc's own, and those of installed packages.

A package acts only where a program names it, so a file that is loaded changes which algorithms act, and when (R103,
R104). A name that does not exist is refused with the program.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from rtc.plugins import registry
from rtc.programs import recovery
from rtc.programs.schema import OWN
from rtc.protocol.outcomes import ProgramError
from rtc.protocol.spelling import unknown


class Field(NamedTuple):
    group: str  # of entry points
    own: Collection[str] = ()  # names of rtc's own algorithms


#: field of a program -> what may stand there
FIELDS = {
    "planners": Field(registry.PLANNERS, (OWN,)),
    "ik": Field(registry.IK, (OWN,)),
    "timing": Field(registry.TIMING, (OWN,)),
    "grasp_planners": Field(registry.GRASP_PLANNERS, (OWN,)),
    "evaluators": Field(registry.EVALUATORS),
    "fillers": Field(registry.FILLERS),
    "trimmers": Field(registry.TRIMMERS, tuple(recovery.BUILT_IN)),
    "phases": Field(registry.PHASES),
}


def problems(program: Any) -> Iterator[tuple[str, str]]:
    """(place, problem): names that neither rtc nor an installed package has. Imports no package."""
    for place, field, name in _added(program):
        if name not in (known := registry.names(field.group)):
            yield place, unknown(registry.GROUPS[field.group], name, {*field.own, *known})


def refuse_missing(program: Any) -> None:
    """Raises ProgramError for a name whose package this process cannot load."""
    for place, field, name in _added(program):
        if why := registry.why_missing(field.group, name):
            raise ProgramError(f"$.{place}: {name}: {why}")


def acted(group: str, name: str, named: Sequence[str]) -> tuple[str, ...]:
    """The note of a trace that this one has acted; none if it is ours and the program leaves no choice."""
    return () if name == OWN and list(named) == [OWN] else (f"{registry.GROUPS[group]} {name}",)


def _added(program: Any) -> Iterator[tuple[str, Field, str]]:
    """Place, field and name of each algorithm of a package."""
    for attribute, field in FIELDS.items():
        for n, name in enumerate(getattr(program, attribute, ())):
            if name not in field.own:
                yield f"{attribute}[{n}]", field, name
