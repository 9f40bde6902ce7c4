"""Every name that is listed is one that a sentence may use, and none is left out."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from rtc.apps.cli.cluster_cell import cell_of
from rtc.apps.cli.names import KINDS, NO_GRASP
from rtc.language.parse import default_grammar, parse
from rtc.model.cells.cell import Cell
from rtc.protocol.sentence import ParsedCommand
from rtc.runtime.settings import Settings


def test_all_names_of_the_cell_are_listed(cell: Cell) -> None:
    rows = [row for read, _ in KINDS.values() for row in read(cell)]
    listed = {name for row in rows for name in (row.name, *row.also)}

    assert set(cell.names()) <= listed
    assert {"HANDLE-A", "HANDLE-B", "LEVEL", "TOOL-Z", "UP"} <= listed


@pytest.mark.parametrize("name", ["swapout", "panda", "gantry", "servicing", "connectors"])
def test_the_examples_are_sentences_with_a_name_of_their_kind(name: str) -> None:
    cell = Cell.load(name)
    for kind, (read, example) in KINDS.items():
        sentence = example(cell)
        assert isinstance(parse(default_grammar(), sentence), ParsedCommand), sentence
        listed = {name for row in read(cell) for name in (row.name, *row.also)}
        assert not listed or listed & set(sentence.split()), kind


def test_the_example_of_a_seat_names_none_that_place_does_not_fill() -> None:
    cell = Cell.load("connectors")
    named = set(KINDS["seats"][1](cell).split())
    assert {seat.name for seat in cell.seats if seat.mating is None} & named


def test_what_no_program_can_grasp_is_marked() -> None:
    cell = Cell.load("servicing")
    things = [msgspec.structs.replace(one, kind="crate") if one.spindle else one for one in cell.objects]
    cell = msgspec.structs.replace(cell, objects=things)
    marked = {row.name for kind in ("objects", "grasp-points") for row in KINDS[kind][0](cell) if NO_GRASP in row.about}

    assert marked == {"POWER-DRIVER", "TOOL-GRIP"}


def test_the_cell_is_that_of_the_cluster(tmp_path: Path) -> None:
    assert cell_of(tmp_path) == "swapout"
    Settings(run_dir=str(tmp_path), cell="/somewhere/cell.yaml").save()
    assert cell_of(tmp_path) == "/somewhere/cell.yaml"
