"""A cell file that extends another one."""

from __future__ import annotations

import pytest

from rtc.apps.authoring.review import review
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import ProgramError


def load(tmp_path, text: str, name: str = "mine.yaml") -> Cell:
    file = tmp_path / name
    file.write_text(text)
    return Cell.load(file)


def test_parts_of_the_same_name_are_merged_and_others_added(tmp_path) -> None:
    base = Cell.load("swapout")
    cell = load(
        tmp_path,
        "name: mine\nextends: swapout\nnumbers: {free_speed_m_s: 0.1}\ntags: [{id: 0, size_m: 0.05}]\n"
        "objects: [{name: MACS-OLD, seat: BAY-2}, {name: POST, kind: structure, fixed: true, "
        "shapes: [{name: post, type: sphere, radius_m: 0.1}]}]\n",
    )
    assert [thing.name for thing in cell.objects] == [*(thing.name for thing in base.objects), "POST"]
    assert cell.object("MACS-OLD").seat == "BAY-2"
    assert cell.object("MACS-OLD").shapes == base.object("MACS-OLD").shapes
    assert cell.numbers.free_speed_m_s == 0.1
    assert cell.numbers.near_speed_m_s == base.numbers.near_speed_m_s
    assert cell.tags[0].size_m == 0.05
    assert cell.tags[1:] == base.tags[1:]
    assert cell.texts == base.texts  # its models are found in the folder of the other cell
    assert Cell.from_bytes(cell.encode()) == cell


def test_an_empty_list_leaves_out_all_of_its_parts(tmp_path) -> None:
    cell = load(tmp_path, "name: mine\nextends: swapout\ncameras: []\ntags: []\n")
    assert cell.cameras == []
    assert cell.tags == []
    assert cell.objects == Cell.load("swapout").objects


@pytest.mark.parametrize(
    "text", ["[" * 25_000, "name: mine\nextends: swapout\nobjects: " + "[" * 25_000 + "]" * 25_000]
)
def test_a_document_that_is_nested_too_deeply_is_refused(tmp_path, text) -> None:
    """It would overflow the stack of the YAML reader, which ends the process."""
    with pytest.raises(ProgramError, match="nested deeper"):
        load(tmp_path, text)
    with pytest.raises(ProgramError, match="nested deeper"):
        review(tmp_path / "mine.yaml")


def test_files_extend_each_other_by_their_place(tmp_path) -> None:
    load(tmp_path, "name: first\nextends: servicing\n", "first.yaml")
    cell = load(tmp_path, "name: second\nextends: first.yaml\n")
    assert cell.name == "second"
    assert cell.object("DOOR-2").hinge is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: mine\nextends: mars\n", "no cell mars"),
        ("name: mine\nextends: mine.yaml\n", "extend each other"),
        ("name: mine\nextends: [swapout]\n", r"\$\.extends"),
        ("name: mine\nextends: swapout\nobjects: [{name: MACS-OLD, seat: NOWHERE}]\n", "no seat NOWHERE"),
        ("name: mine\nextends: swapout\nobjects: [{name: MACS-OLD, colour: red}]\n", "unknown field"),
    ],
)
def test_a_wrong_extension_is_refused(tmp_path, text, words) -> None:
    with pytest.raises(ProgramError, match=words):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("hinge", "words"),
    [
        ("{range_deg: [0, 90], axis: [0, 0, 2]}", "unit length"),
        ("{range_deg: [90, 0]}", "range_deg"),
        ("{range_deg: [0, 400]}", "range_deg"),
        ("{range_deg: [0, 90], at_deg: 100}", "not within 0 to 90"),
        ("{range_deg: [0, 90], friction_nm: -1}", "friction_nm"),
    ],
)
def test_a_wrong_hinge_is_refused(tmp_path, hinge, words) -> None:
    with pytest.raises(ProgramError, match=words):
        load(tmp_path, f"name: mine\nextends: servicing\nobjects: [{{name: DOOR-2, hinge: {hinge}}}]\n")


def test_a_hinge_and_a_seat_exclude_each_other(tmp_path) -> None:
    with pytest.raises(ProgramError, match="neither fixed nor in a seat"):
        load(tmp_path, "name: mine\nextends: servicing\nobjects: [{name: DOOR-2, seat: RACK-2}]\n")


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("seats: [{name: BAY-2, mounted_on: SATTELITE}]", "SATTELITE"),
        ("seats: [{name: RACK-1, mounted_on: MACS-OLD}]", "mounted on nothing MACS-OLD"),
        ("objects: [{name: DOOR-2, mounted_on: BOLT-1}]", "mounted on nothing BOLT-1"),
        ("objects: [{name: POWER-DRIVER, mounted_on: SATELLITE}]", "is fixed or has a hinge"),
        ("objects: [{name: SATELLITE, mounted_on: SATELLITE}]", "mounted on nothing SATELLITE"),
    ],
)
def test_a_wrong_mount_is_refused(tmp_path, part, words) -> None:
    with pytest.raises(ProgramError, match=words):
        load(tmp_path, f"name: mine\nextends: servicing\n{part}\n")
