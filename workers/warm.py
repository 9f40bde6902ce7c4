"""What a worker has made before its first job, so that this is as quick as any: the programs and the cell that come
with the project, by digest. On a slow machine the first job would else be too late, three times, and be poison.

The broker names programs and cells by the digest of their bytes alone. So whatever is made here from the same bytes
is the same thing, and whatever is not asked for does no harm: a changed program is fetched as ever.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rtc import program
from rtc.cell import Cell
from rtc.digest import digest
from rtc.messages import WorkerKind
from rtc.outcomes import ProgramError
from workers import imports


@dataclass(frozen=True)
class Preloaded:
    """Compiled programs of each kind, and cell models; all by digest."""

    programs: Mapping[WorkerKind, Mapping[str, Any]] = field(default_factory=dict)
    cells: Mapping[str, Any] = field(default_factory=dict)


def preload(kinds: Iterable[WorkerKind], cell: str | None) -> Preloaded:
    """These kinds' own programs compiled, and, for those that need it, the models of the cluster's `cell`, when it is
    known. A program that does not check is left to the broker, who tells what is wrong with it."""
    programs: dict[WorkerKind, dict[str, Any]] = {}
    cells: dict[str, Any] = {}
    for kind in kinds:
        function: Any = imports.load(kind)
        try:
            body = program.default(kind)
            programs[kind] = {digest(body): function.compile(body)}
        except ProgramError as error:
            logging.getLogger("warm").warning("%s: %s", kind, error)
        if function.NEEDS_CELL and cell is not None and not cells:
            body = Cell.load(cell).encode()
            model = imports.load("cell_model").CellModel(Cell.from_bytes(body))
            _ = model.arms, model.collision  # built when first asked for
            cells[digest(body)] = model
    return Preloaded(programs, cells)
