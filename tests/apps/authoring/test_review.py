"""`rtc cell check`: all faults at once, each with its place, its line and what was expected."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pytest
import yaml

from rtc.apps.authoring.review import Finding, review
from rtc.apps.authoring.robot_file import RobotFile
from rtc.model.cells.cell import CELLS
from rtc.protocol.outcomes import ProgramError
from tests.apps.authoring.conftest import DATA
from tests.plugins.tool_changer.cells import with_hands


@pytest.fixture
def copy(first_cell, tmp_path):
    """A first cell that a test may spoil."""
    shutil.copytree(first_cell("PANDA").parent, tmp_path / "cell")
    return tmp_path / "cell" / "cell.yaml"


def spoil(file: Path, *changes: tuple[str, str]) -> None:
    text = file.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    file.write_text(text)


def found(file: Path) -> dict[str, Finding]:
    return {finding.where: finding for finding in review(file)[0]}


@pytest.mark.parametrize("name", sorted(path.parent.name for path in CELLS.glob("*/cell.yaml")))
def test_the_cells_of_the_project_have_no_error(name):
    """In one of them a closed door is before a module, which is a warning."""
    findings, cell = review(CELLS / name)
    assert [finding for finding in findings if finding.severity == "error"] == []
    assert cell is not None


def test_all_faults_of_the_fields_are_found_at_once(copy):
    spoil(
        copy,
        ("payload_kg: ", "payload_kg: -"),
        ("kind: pad", "kindd: pad"),
        ("mass_kg: 0.5", "mass_kg: heavy"),
        ("name: panda", "name: panda\nlights: 3"),
    )
    rows = found(copy)
    assert {"$.arms[0].payload_kg", "$.seats[0].kindd", "$.objects[1].mass_kg", "$.lights"} <= set(rows)
    lines = copy.read_text().splitlines()
    assert "payload_kg" in lines[rows["$.arms[0].payload_kg"].line - 1]
    assert "heavy" in lines[rows["$.objects[1].mass_kg"].line - 1]


def test_names_keys_and_gravity_that_the_types_allow_are_checked(tmp_path):
    """A reserved word as a name, a key given twice, a name in small letters, too few values, gravity upwards."""
    shutil.copytree(CELLS / "panda", tmp_path / "cell")
    file = tmp_path / "cell" / "cell.yaml"
    spoil(
        file,
        ("name: panda\n", "name: panda\nname: again\n"),
        ("[0, 0, -9.81]", "[0, 0, 9.81]"),
        ("  - name: CUBE-1", "  - name: HALT"),
        ("  - name: CUBE-2", "  - name: cube-2"),
        ("acceleration_deg_s2: [300, 240, 300, 300, 500, 500, 500]", "acceleration_deg_s2: [300, 240]"),
    )
    findings, cell = review(file)
    rows = {one.where: one for one in findings}
    names = sorted(one.where for one in findings if "objects" in one.where and one.where.endswith(".name"))
    assert cell is None
    assert rows["$.name"].line == 6
    assert rows["$.gravity_m_s2"].severity == "warning"
    assert len(names) == 2
    assert "word of the command language" in rows[names[0]].problem
    assert "capital letters" in rows[names[1]].problem
    assert not [one for one in findings if one.where == "$.arms[0].urdf"]
    spoil(file, ("cube-2", "CUBE-2"))
    assert "7 joints" in found(file)["$.arms[0].acceleration_deg_s2"].problem
    assert "$.arms[0].urdf" not in found(file)


def test_references_and_models_are_checked_too(copy):
    spoil(copy, ("seat: PAD-1", "seat: PAD-9"), ("panda_joint7]", "panda_joint8]"))
    spoil(copy.parent / "panda.urdf", ('velocity="2.1750"', 'velocity="0"'))
    spoil(copy.parent / "panda.srdf", ('link2="panda_link7"', 'link2="panda_link77"'))
    rows = found(copy)
    assert {"$.objects[1].seat", "$.arms[0].joints", "joint panda_joint1", "link2 panda_link77"} <= set(rows)
    assert "panda_joint1" in (copy.parent / "panda.urdf").read_text().splitlines()[rows["joint panda_joint1"].line - 1]


def test_geometry_is_checked(copy):
    """A place out of reach, a home in the floor, a neighbour that is not in the SRDF, one body inside another."""
    spoil(copy, ("poses: {PANDA: {xyz: [0", "poses: {PANDA: {xyz: [1"), ("seat: PAD-1", "frame: {xyz: [0, 0, 0.0]}"))
    text = copy.read_text()
    home = next(line for line in text.splitlines() if "home_deg" in line)
    spoil(copy, (home, "    home_deg: [0, 100, 0, -10, 0, 90, 0]"))
    spoil(copy.parent / "panda.srdf", ('link2="panda_link1"', 'link2="panda_link0"'))
    rows = found(copy)
    assert {"$.places[0].poses.PANDA", "$.arms[0].home_deg", "$.arms[0].srdf", "$.objects[1].frame"} <= set(rows)
    assert "cannot reach" in rows["$.places[0].poses.PANDA"].problem
    assert rows["$.arms[0].srdf"].severity == "warning"


@pytest.mark.parametrize(
    ("yaw_deg", "width_m", "problem"),
    [
        (85, 0.04, ""),
        (125, 0.04, "at TOP the fingers close at 35 deg to the sides of body"),
        (0, 0.05, "TOP is 50 mm wide; body is 40 mm there"),
    ],
)
def test_fingers_close_on_two_sides_as_wide_as_stated(copy, yaw_deg, width_m, problem):
    """A hand that takes a cube across its corners closes at another width, and the grasp fails."""
    plain = yaml.safe_load(copy.read_text())
    (cube,) = (thing for thing in plain["objects"] if thing["name"] == "CUBE")
    cube["grasp_points"][0]["frame"]["rpy_deg"] = [180, 0, yaw_deg]
    cube["grasp_points"][0]["width_m"] = width_m
    copy.write_text(yaml.safe_dump(plain))
    finding = found(copy).get("$.objects[1].grasp_points[0]")
    assert (finding.problem if finding else "") == problem


def test_an_arm_is_checked_with_each_of_its_hands(tmp_path):
    cell = with_hands()
    for name, text in cell.texts.items():
        (tmp_path / name).write_text(text)
    file = tmp_path / "cell.yaml"
    file.write_bytes(msgspec.structs.replace(cell, texts={}).encode())
    assert found(file) == {}
    spoil(tmp_path / "HAND-B.urdf", ('<mass value="0.6"/>', '<mass value="-1"/>'))
    assert {"link palm"} == set(found(file))
    (tmp_path / "HAND-A.urdf").unlink()
    assert "$.arms[0].hands[0].urdf" in found(file)


def test_a_posture_that_the_motors_cannot_hold_is_an_error(copy):
    spoil(copy.parent / "panda.urdf", ('effort="87"', 'effort="2"'), ('effort="87"', 'effort="2"'))
    rows = found(copy)
    assert "its motor has 2" in rows["$.arms[0].home_deg"].problem


def test_a_urdf_alone_is_checked():
    rows = found(DATA / "xarm" / "xarm6_with_gripper.urdf")
    assert set(rows) == {"link link2", "link link3"}
    assert "rigid body" in rows["link link2"].problem
    assert found(DATA / "kuka_iiwa" / "model.urdf") == {}


def test_yaml_that_cannot_be_read_has_a_line(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("name: x\narms: [\n")
    (finding,) = review(file)[0]
    assert finding.severity == "error"


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ProgramError, match=r"\.urdf"):
        review(tmp_path / "arm.xacro")
    with pytest.raises(ProgramError, match="cannot read"):
        review(tmp_path / "missing.yaml")


def test_a_mesh_path_that_leaves_its_package_is_not_followed(tmp_path):
    (tmp_path / "outside.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    (tmp_path / "package").mkdir()
    robot = RobotFile(tmp_path / "package" / "arm.urdf", '<robot name="a"><link name="l"/></robot>')
    assert robot.mesh_file("package://../outside.obj") is None
    assert robot.mesh_file("package://package/../../outside.obj") is None
    assert robot.mesh_file("../outside.obj") == tmp_path / "package" / "../outside.obj"  # beside the URDF, as stated
