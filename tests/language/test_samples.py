"""All sentences of samples.txt: what each ends in, in the cell and the state that it needs, on perfect reports.

A sentence succeeds, or its refusal is true of the cell: it names what the cell lacks, or why the verb cannot be done.
The broker alone performs the sentences of control and LOAD; tests of the Decision Unit show those.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from broker.decisions.command.control import CONTROLS
from broker.decisions.command.loading import LOAD
from rtc.model.cells.cell import Cell
from rtc.programs import loader
from tests.workers.conftest import Bench, Reporter, record
from workers.planning.robot_models import CellModel

SAMPLES = dict(line.split(": ", 1) for line in Path(__file__).with_name("samples.txt").read_text().splitlines())
SWAPOUT, SERVICING = "swapout", "servicing"
TAKEN = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
OUT = (TAKEN, "EXTRACT MACS-NEW FROM RACK-1")
BOTH = (*OUT, "CARRY MACS-NEW TO CLEAR-POINT-1 WITH BOTH-ARMS")
DOOR = ("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL",)
OPENED = (*DOOR, "PULL DOOR-2 BY 10 CM")
OLD_OUT = ("SET MACS-OLD SEAT BAY-2", "GRASP RIGHT-END-EFF MACS-OLD HANDLE-A")


class Done(NamedTuple):
    """It succeeds after these sentences in this cell."""

    after: tuple[str, ...] = ()
    cell: str = SWAPOUT


class Not(NamedTuple):
    """It is refused with these words."""

    words: str
    after: tuple[str, ...] = ()
    cell: str = SWAPOUT


NO_OPERATOR = "no operator among the subsystems"
WANTED: dict[str, Done | Not] = {
    "S1": Not("is fixed", cell=SWAPOUT),
}


def test_each_sample_has_its_end() -> None:
    assert len(SAMPLES) == 59
