"""The file of taught places: kept, and read only as far as it fits the cell."""

from __future__ import annotations

import math

import msgspec
import pytest

from rtc.model.cells import taught, taught_file
from rtc.model.cells.cell import Cell

HERE = [0.1, -0.2, 0.3, 0.0, 1.0, -1.0]


@pytest.fixture
def cell(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return Cell.load("swapout")


def test_what_is_saved_is_loaded(cell):
    assert taught_file.load(cell) == {}
    known = {"P1": {"RIGHT-ARM": HERE}}
    file = taught_file.save(cell, known)
    assert taught_file.load(cell) == known
    assert [one.name for one in file.parent.iterdir()] == [file.name]


def test_what_does_not_fit_the_cell_is_left_out(cell):
    known = {"P1": {"RIGHT-ARM": HERE, "LEFT-ARM": [0.0]}, "P2": {"PANDA": HERE}, "RACK-1": {"RIGHT-ARM": HERE}}
    taught_file.save(cell, known)
    assert taught_file.load(cell) == {"P1": {"RIGHT-ARM": HERE}}


def test_a_damaged_file_raises_what_its_readers_expect(cell):
    file = taught_file.save(cell, {})
    file.write_bytes(b"[1]")
    with pytest.raises(msgspec.MsgspecError):
        taught_file.load(cell)


def test_facts_become_places_of_the_cell(cell):
    facts = [(taught.key_of("P1", "RIGHT-ARM"), HERE), (taught.key_of("P2", "LEFT-ARM"), None), ("P1.frame", HERE)]
    known = taught.postures(facts)
    assert known == {"P1": {"RIGHT-ARM": HERE}}
    (place,) = taught.as_places(cell, known)
    assert place.joints_rad("RIGHT-ARM") == pytest.approx(HERE)
    assert place.joints_deg["RIGHT-ARM"][0] == pytest.approx(math.degrees(0.1))
