"""The mechanisms of the robot, each in one folder: what it can do with touch, bolts, doors and so on."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from workers.mechanisms import (
    bolts,
    connectors,
    facts,
    grip,
    hinges,
    installed_rows,
    operator,
    seats,
    sight,
    touch,
    two_arms,
)
from workers.mechanisms.mechanism import Mechanism

MECHANISMS: tuple[Mechanism, ...] = (
    facts.MECHANISM,
    hinges.MECHANISM,
    grip.MECHANISM,
    seats.MECHANISM,
    bolts.MECHANISM,
    connectors.MECHANISM,
    touch.MECHANISM,
    sight.MECHANISM,
    operator.MECHANISM,
    two_arms.MECHANISM,
)

Key = TypeVar("Key")
Part = TypeVar("Part")


@functools.cache
def installed() -> installed_rows.InstalledRows:
    """Those of installed packages. They are loaded once in a process, when the first stage is imported."""
    return installed_rows.load(MECHANISMS)


def every() -> tuple[Mechanism, ...]:
    """Ours in their order, then those of packages."""
    return (*MECHANISMS, *installed().used)


def refuse_missing(program: Any) -> None:
    """Raises ProgramError for a word of a package that this process does not have."""
    installed_rows.refuse_missing(program, installed())


def each(part: Callable[[Mechanism], Part | None]) -> list[Part]:
    """This part of each mechanism that states it, in the order in which they are asked."""
    return [found for mechanism in every() if (found := part(mechanism)) is not None]


def joined(part: Callable[[Mechanism], Mapping[Key, Part]]) -> dict[Key, Part]:
    """This part of all mechanisms in one table. No two mechanisms use the same word."""
    rows = [row for mechanism in every() for row in part(mechanism).items()]
    assert len(dict(rows)) == len(rows), sorted(str(key) for key, _ in rows)
    return dict(rows)
