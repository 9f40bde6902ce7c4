"""Preloading: compile the default programs and build the default cell before a worker's first job.

Without it, the first job on a slow machine may exceed its deadline three times and count as poisonous. The broker
identifies programs and cells by the digest of their bytes. A preloaded item is therefore used only if its bytes are the
same; a changed program is fetched from the broker as usual.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rtc.model.cells.cell import Cell
from rtc.programs import loader
from rtc.protocol.digest import digest
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError
from workers.runtime import lazy_import


@dataclass(frozen=True)
class Preloaded:
    """Compiled programs by kind and digest, and cell models by digest."""

    programs: Mapping[WorkerKind, Mapping[str, Any]] = field(default_factory=dict)
    cells: Mapping[str, Any] = field(default_factory=dict)


def preload(kinds: Iterable[WorkerKind], cell: str | None) -> Preloaded:
    """Compile the default programs of `kinds` and, if one of them needs it, build the models of `cell`.

    `cell` is None if the cluster's cell is not known. A program that does not compile is only logged; the broker
    reports its error.
    """
    programs: dict[WorkerKind, dict[str, Any]] = {}
    cells: dict[str, Any] = {}
    for kind in kinds:
        function: Any = lazy_import.load(kind)
        try:
            body = loader.default(kind)
            programs[kind] = {digest(body): function.compile(body)}
        except ProgramError as error:
            logging.getLogger("workers.preload").warning("%s: %s", kind, error)
        if function.NEEDS_CELL and cell is not None and not cells:
            body = Cell.load(cell).encode()
            model = lazy_import.load("workers.planning.robot_models").CellModel(Cell.from_bytes(body))
            _ = model.arms, model.collision  # build these cached properties now
            cells[digest(body)] = model
    return Preloaded(programs, cells)
