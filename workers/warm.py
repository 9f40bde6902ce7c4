"""What a worker may have made before its first job: the programs and the cell that come with the project, by digest.

The broker names programs and cells by the digest of their bytes alone. So whatever is made here from the same bytes
is the same thing, and whatever is not asked for does no harm: a changed program is fetched as ever.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtc import program
from rtc.cell import Cell
from rtc.digest import digest
from rtc.messages import WorkerKind
from rtc.outcomes import ProgramError
from rtc.settings import Settings
from workers import imports


@dataclass(frozen=True)
class Warm:
    """Compiled programs of each kind, and cell models; all by digest."""

    programs: Mapping[WorkerKind, Mapping[str, Any]] = field(default_factory=dict)
    cells: Mapping[str, Any] = field(default_factory=dict)


def warm(run_dir: Path) -> Warm:
    """All four kinds' own programs compiled, and the models of the cluster's cell. A program that does not check is
    left to the broker, who tells what is wrong with it."""
    programs: dict[WorkerKind, dict[str, Any]] = {}
    for kind in WorkerKind:
        try:
            body = program.default(kind)
            programs[kind] = {digest(body): imports.load(kind).compile(body)}
        except ProgramError as error:
            logging.getLogger("template").warning("%s: %s", kind, error)
    body = Cell.load(Settings.load(run_dir).cell).encode()
    model = imports.load("cell_model").CellModel(Cell.from_bytes(body))
    _ = model.arms, model.collision  # built when first asked for
    return Warm(programs, {digest(body): model})
