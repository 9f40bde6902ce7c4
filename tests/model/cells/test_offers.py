"""Names that fit where they are offered, in the sentence that is being typed."""

from __future__ import annotations

import pytest

from rtc.language.completion import complete
from rtc.language.parse import default_grammar
from rtc.model.cells.cell import Cell
from rtc.model.cells.offers import CellNames

MODULES = ["MACS-NEW", "MACS-OLD"]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("GRASP ", MODULES),
        ("GRASP RIGHT-END-EFF ", MODULES),
        ("GRASP RIGHT-END-EFF MACS-NEW ", ["HANDLE-A", "HANDLE-B"]),
        ("TEST GRASP macs_new h", ["HANDLE-A", "HANDLE-B"]),
        ("GRASP MACS-NEW AT ", ["HANDLE-A", "HANDLE-B"]),
        ("APPROACH SATELLITE ", []),
        ("LIFT ", MODULES),
        ("PLACE MACS-NEW ON ", ["BAY-2", "RACK-1", "RACK-2"]),
        ("MOVE RIGHT-ARM TO R", ["RACK-1-FRONT", "RACK-2-FRONT"]),
        ("MOVE RIGHT-ARM TO-NEIGHBORHOOD-OF ", [*MODULES, "SATELLITE"]),
        ("MOVE RIGHT-ARM BY 5 CM ALONG T", ["TOOL-X", "TOOL-Y", "TOOL-Z"]),
        ("STOW LEFT-ARM MAINTAIN AVOID-TASK-REGION ", ["BAY-2-RANGE", "CELL-RANGE", "SOLAR-ARRAY"]),
        ("LIFT MACS-NEW MAINTAIN POSE-DURING-MOTION ", ["LEVEL"]),
        ("STOW LEFT-ARM AFTER ", ["LAST"]),
        ("VERIFY ", [*MODULES, "SATELLITE"]),
        ("SET ", None),
        ("", None),
    ],
)
def test_names_that_fit(text: str, names: list[str] | None, cell: Cell) -> None:
    grammar = default_grammar()
    reserved = grammar.vocabulary.reserved
    offered = [word for word in complete(grammar, text, CellNames(cell)) if word not in reserved]
    if names is not None:
        assert offered == names
    elif text:
        assert set(MODULES) < set(offered)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("STOW LEFT-ARM AFTER ", ["C-7", "LAST"]),
        ("PAUSE ", ["C-7"]),
        ("MOVE RIGHT-ARM TO P", ["P1"]),
        ("MOVE RIGHT-ARM TO POSITION 1 2 3 CM THROUGH P", ["P1"]),
        ("PLACE MACS-NEW ON P", []),
    ],
)
def test_names_of_the_running_cluster(text: str, names: list[str], cell: Cell) -> None:
    known = CellNames(cell, places=lambda: ["P1"], commands=lambda: ["C-7"])
    reserved = default_grammar().vocabulary.reserved

    assert [word for word in complete(default_grammar(), text, known) if word not in reserved] == names
