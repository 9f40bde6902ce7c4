"""Figures of a cell and a URDF that are not plausible: a warning with the range and the reason, none for our cells."""

from __future__ import annotations

import re
import shutil
import typing
from pathlib import Path

import msgspec
import pytest

from rtc.apps.authoring import plausible
from rtc.apps.authoring.draft import draft
from rtc.apps.authoring.plausible import RANGES, of_cell
from rtc.apps.authoring.review import of_urdf, review
from rtc.model.cells.cell import CELLS, Cell
from rtc.model.cells.parts import CellPart
from tests.apps.authoring import small_arms

#: figures of a cell that their types limit, that geometry or the models judge, or that may have any value
JUDGED_ELSEWHERE = {
    *("Frame.xyz", "Frame.rpy_deg", "Shape.colour", "Arm.home_deg", "Arm.stow_deg", "Place.joints_deg"),
    *("Seat.way_out", "Hinge.axis", "Hinge.range_deg", "Hinge.at_deg", "Object.inertia_kg_m2"),
    *("Object.centre_of_mass_m", "Camera.xyz", "Camera.looks_at", "Camera.up", "Camera.field_of_view_deg"),
    *("Camera.size_px", "Camera.exposure", "Tag.id", "Cell.gravity_m_s2"),
}
SWAPOUT = (CELLS / "swapout" / "cell.yaml").read_text("utf-8")


@pytest.fixture
def swapout(tmp_path: Path) -> Path:
    shutil.copytree(CELLS / "swapout", tmp_path / "cell")
    return tmp_path / "cell" / "cell.yaml"


@pytest.mark.parametrize("name", sorted(path.parent.name for path in CELLS.glob("*/cell.yaml")))
def test_the_cells_that_come_with_rtc_are_plausible(name: str) -> None:
    assert list(of_cell(Cell.load(name))) == []
    for urdf in (CELLS / name).glob("*.urdf"):
        assert [one for one in of_urdf(urdf, in_cell=True) if "soft limits" not in one.problem] == []


def test_each_figure_of_a_cell_has_a_range() -> None:
    kinds, figures = [CellPart], set[str]()
    for kind in kinds:  # it grows
        kinds += kind.__subclasses__()
        own = {f.name for f in msgspec.structs.fields(kind)} - {
            f.name for base in kind.__bases__ if base is not CellPart and issubclass(base, CellPart)
            for f in msgspec.structs.fields(base)
        }  # fmt: skip
        types = typing.get_type_hints(kind) if own else {}
        figures |= {f"{kind.__name__}.{name}" for name in own if re.search(r"\b(float|int)\b", str(types[name]))}
    assert figures - RANGES.keys() - JUDGED_ELSEWHERE == set()
    assert RANGES.keys() - figures == set()


@pytest.mark.parametrize(
    ("before", "after", "where", "severity"),
    [
        ("payload_kg: 2.5", "payload_kg: 1.0e+6", "payload_kg", "warning"),
        ("[200, 200, 300", "[2.0e+9, 200, 300", "acceleration_deg_s2[0]", "warning"),
        ("[200, 200, 300", "[1.0e-9, 200, 300", "acceleration_deg_s2[0]", "warning"),
        ("max_force_n: 60", "max_force_n: 1.0e+9", "max_force_n", "warning"),
        ("depth_m: 0.12", "depth_m: 1200", "depth_m", "warning"),
        ("detent_n: 10", "detent_n: 1000000", "detent_n", "warning"),
        ("friction: 0.2", "friction: 1000000", "friction", "warning"),
        ("[0.0145, 0.0125, 0.0165]", "[1000, 1000, 1000]", "inertia_kg_m2", "warning"),
        ("[0.0145, 0.0125, 0.0165]", "[0.000000000001, 1, 5]", "inertia_kg_m2", "error"),
        ("size_m: 0.064", "size_m: 6.4", "tags[0].size_m", "warning"),
        ("[0.055, 0.075, 0.0805]", "[0.055, 0.075, 0.01]", "tags[", "warning"),
    ],
)
def test_a_figure_that_is_hardly_meant_is_stated(
    swapout: Path, before: str, after: str, where: str, severity: str
) -> None:
    """Each passed without a word, and the arm moved with it."""
    assert before in SWAPOUT
    swapout.write_text(SWAPOUT.replace(before, after, 1), "utf-8")
    found = [one for one in review(swapout)[0] if where in one.where]
    assert {one.severity for one in found} == {severity}
    assert all(one.expected for one in found)


ARM = [
    small_arms.Joint((0.0, 0.0, 0.2), axis, (0.06, 0.06, 0.2), (0.0, 0.0, 0.1), 1.0, (-2.8, 2.8))
    for axis in ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
]


def test_the_figures_of_a_joint_are_judged(tmp_path: Path) -> None:
    text = small_arms.urdf("R", ARM).replace('effort="100.0" velocity="2"/>', 'effort="1e9" velocity="1e9"/>\n'
                                             '<dynamics damping="1e6" friction="1e6"/>', 1)  # fmt: skip
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    found = [one for one in of_urdf(path) if one.where == "joint joint_1"]
    assert [one.severity for one in found] == ["warning"] * 4
    assert plausible.OF_JOINT.keys() >= {("revolute", one.problem.split()[1]) for one in found}


def test_links_without_a_shape_are_stated_by_the_check_and_with_a_new_cell(tmp_path: Path) -> None:
    """An arm without any shape collides with nothing, and nothing was stated."""
    path = tmp_path / "arm.urdf"
    path.write_text(small_arms.urdf("R", ARM))
    assert list(of_urdf(path)) == []
    path.write_text(re.sub("<collision>.*</collision>", "", small_arms.urdf("R", ARM)))
    assert {one.where for one in of_urdf(path)} == {f"link link_{n}" for n in range(1, 7)}
    assert [note for note in draft(path).notes if "link_2" in note]


def test_names_with_signs_of_xml_are_written_as_such(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(small_arms.urdf("R&amp;D &lt;1&gt;", ARM).replace("link_2", "link&amp;2"))
    made = draft(path)
    assert 'link1="base" link2="link_1"' in made.files[f"{made.cell.name}.srdf"]
    assert "link&amp;2" in made.files[f"{made.cell.name}.srdf"]
