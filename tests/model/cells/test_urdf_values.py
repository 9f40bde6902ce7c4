"""Wrong values of a URDF: each with its place and what was expected. And plain refusals instead of tracebacks."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import pytest

from rtc.apps.authoring.adapt import adapt, normalise
from rtc.apps.authoring.review import review
from rtc.apps.authoring.robot_file import RobotFile, kinematics
from rtc.model.cells import model_checks, urdf_values
from rtc.model.cells.cell import CELLS, Cell
from rtc.protocol.outcomes import ProgramError
from tests.apps.authoring import small_arms
from tests.apps.authoring.conftest import DATA

ARM = """<robot name="a">
<link name="base"/>
<link name="tip">
 <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
 <collision><geometry><box size="1 1 1"/></geometry></collision>
</link>
<joint name="turn" type="revolute">
 <parent link="base"/><child link="tip"/><origin xyz="0 0 1"/>
 <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="5" velocity="1"/>
</joint>
</robot>"""


def faults(text):
    return list(urdf_values.faults(ElementTree.fromstring(text)))


def test_a_sound_model_has_none():
    assert faults(ARM) == []
    for urdf in CELLS.glob("*/*.urdf"):
        assert faults(urdf.read_text()) == []


WRONG = [
    ('xyz="0 0 1"/><limit', 'xyz="0 0 0"/><limit', "joint turn", "unit vector"),
    ('xyz="0 0 1"/><limit', 'xyz="0 nan 0"/><limit', "joint turn", "three finite"),
    ('<origin xyz="0 0 1"', '<origin xyz="0 0"', "joint turn", "three finite"),
    ('<origin xyz="0 0 1"', '<origin xyz="0 0 x"', "joint turn", "three finite"),
    ('lower="-1"', 'lower="-inf"', "joint turn", "finite"),
    ('lower="-1"', 'lower="2"', "joint turn", "lower below upper"),
    ('type="revolute"', 'type="rotary"', "joint turn", "revolute"),
    ('mass value="1"', 'mass value="nan"', "link tip", "finite"),
    ('mass value="1"', "mass", "link tip", "finite"),
    ('mass value="1"', 'mass value="-1"', "link tip", "above 0"),
    ('ixx="1"', 'ixx="inf"', "link tip", "finite"),
    (' iyz="0"', "", "link tip", "finite"),
    ('<mass value="1"/>', "", "link tip", "mass"),
    ('size="1 1 1"', 'size="1 0 1"', "link tip", "above 0"),
    ("<box ", "<capsule ", "link tip", "<box>"),
    ('<box size="1 1 1"/>', '<mesh filename="a.obj" scale="0 1 1"/>', "link tip", "above 0"),
    ("<axis", '<mimic joint="other"/><axis', "joint turn", "another joint"),
    ('<link name="base"/>', '<link name="base"/><link name="base"/>', "link base", "own"),
    ('<robot name="a">', "<robot>", "robot", "name"),
    ("<limit ", '<limit lower="-2" upper="2" effort="9" velocity="9"/><limit ', "joint turn", "one"),
    ("<axis ", '<axis xyz="1 0 0"/><axis ', "joint turn", "one"),
    ('<mass value="1"/>', '<mass value="1"/><mass value="2"/>', "link tip", "one"),
    ("<collision>", '<collision><origin/><origin xyz="0 0 1"/>', "link tip", "one"),
    ('<origin xyz="0 0 1"', '<origin xyz="0 0 1" quat_xyzw="0 0 0 1"', "joint turn", "rpy"),
    ('<origin xyz="0 0 1"', '<origin xyz="0 0 1" rpy="90 0 0"', "joint turn", "rad"),
    ("<axis ", '<dynamics damping="-1"/><axis ', "joint turn", "below 0"),
]


@pytest.mark.parametrize(("before", "after", "where", "expected"), WRONG)
def test_check_and_new_and_up_state_its_place_and_what_is_expected(before, after, where, expected, tmp_path):
    """`rtc cell check` with the line; `rtc cell new` and `rtc up` refuse."""
    text = ARM.replace(before, after, 1)
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    found = [one for one in review(file)[0] if one.severity == "error"]
    assert {(one.where, bool(one.line)) for one in found} == {(where, where != "robot")}
    assert expected in found[0].expected
    with pytest.raises(ProgramError, match=where) as refused:
        adapt(file, "hulls")
    assert expected in str(refused.value)
    cell = Cell.load("swapout")
    arm = cell.arms[0]
    problems = list(model_checks.problems([arm], {**cell.texts, arm.urdf: text}))
    assert [place for place, _ in problems] == ["arms[0].urdf"]
    assert expected in problems[0][1]


@pytest.mark.parametrize(
    ("xyz", "unit"), [("0 0 2", "0 0 1"), ("0 0.1 0", "0 1 0"), ("0 0.707 0.707", "0 0.707107 0.7")]
)
def test_an_axis_without_unit_length_is_an_error_of_a_cell_and_mended_in_a_new_one(xyz, unit, tmp_path):
    """A simulator takes the length, too: the arm falls, or feels forces that are not there."""
    text = ARM.replace('xyz="0 0 1"/><limit', f'xyz="{xyz}"/><limit', 1)
    (fault,) = faults(text)
    assert fault.where == "joint turn"
    assert unit in fault.expected
    cell = Cell.load("swapout")
    arm = cell.arms[0]
    assert unit in next(problem for _, problem in model_checks.problems([arm], {**cell.texts, arm.urdf: text}))
    robot, notes = RobotFile(tmp_path / "arm.urdf", text), []
    normalise(robot, notes)
    assert faults(ElementTree.tostring(robot.robot, encoding="unicode")) == []
    assert ["axis of turn" in note for note in notes] == [True]


def test_the_axes_of_the_cells_of_the_project_have_unit_length():
    for urdf in CELLS.glob("*/*.urdf"):
        moving = (
            joint for joint in ElementTree.fromstring(urdf.read_text()).iter("joint") if joint.get("type") != "fixed"
        )
        for axis in (axis for joint in moving for axis in joint.findall("axis")):
            assert math.hypot(*map(float, axis.get("xyz").split())) == pytest.approx(1.0, abs=1e-9)


def test_lengths_in_millimetres_are_suspected(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(ARM.replace('xyz="0 0 1"', 'xyz="0 0 333"', 1))
    (finding,) = review(file)[0]
    assert (finding.severity, finding.where, finding.expected) == ("warning", "joint turn", "metres")
    with pytest.raises(ProgramError, match="millimetres"):
        adapt(file, "hulls")


def test_joints_in_a_ring_beside_the_tree_are_refused(tmp_path):
    """They would be followed endlessly."""
    ring = "".join(
        f'<link name="{a}"/><joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for a, b in (("x", "y"), ("y", "x"))
    )
    with pytest.raises(ProgramError, match="x, y form a ring"):
        RobotFile(tmp_path / "arm.urdf", ARM.replace("</robot>", f"{ring}</robot>"))


def test_what_the_kinematics_cannot_read_is_a_refusal(tmp_path):
    text = ARM.replace("<axis", "<dynamics/><axis")
    with pytest.raises(ProgramError, match=r"arm\.urdf"):
        kinematics(text, tmp_path / "arm.urdf")
    (tmp_path / "arm.urdf").write_text(text)
    (finding,) = review(tmp_path / "arm.urdf")[0]
    assert finding.severity == "error"


@pytest.mark.parametrize(
    ("name", "words"), [("husky/husky.urdf", "expand it first"), ("pr2_gripper.urdf", "2 joints or more")]
)
def test_published_models_that_are_not_arms_are_refused(name, words):
    with pytest.raises(ProgramError, match=words):
        adapt(DATA / name, "hulls")


def test_two_joints_with_one_name_are_refused_as_such(tmp_path):
    file = tmp_path / "arm.urdf"
    joint = ARM[ARM.index("<joint") : ARM.index("</robot>")]
    file.write_text(ARM.replace("</robot>", f'<link name="more"/>{joint.replace("tip", "more")}</robot>'))
    with pytest.raises(ProgramError, match="joint turn: 2 of them"):
        RobotFile(file)


@pytest.mark.parametrize("vertices", ["v nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n", "", "solid"])
def test_a_mesh_without_finite_vertices_is_refused_in_one_line(vertices, tmp_path):
    (tmp_path / "a.obj").write_text(vertices)
    file = tmp_path / "arm.urdf"
    file.write_text(ARM.replace('<box size="1 1 1"/>', '<mesh filename="a.obj"/>'))
    robot = RobotFile(file)
    with pytest.raises(ProgramError) as refused:
        robot.vertices(robot.robot.find("link/collision/geometry/mesh"))
    assert "\n" not in str(refused.value)
    assert ".cpp" not in str(refused.value)


def test_an_inertia_far_too_great_for_a_link_of_boxes_is_replaced_and_limits_in_degrees_are_noted(tmp_path):
    file = tmp_path / "arm.urdf"
    robot = ElementTree.fromstring(small_arms.urdf("six", small_arms.SIX, finger_kg=0.05))
    robot.find("link[@name='link_3']/inertial/inertia").set("izz", "50")
    robot.find("joint[@name='joint_2']/limit").attrib.update(lower="-120", upper="120")
    file.write_text(ElementTree.tostring(robot, encoding="unicode"))
    adapted = adapt(file, "hulls")
    inertia = adapted.robot.links["link_3"].find("inertial/inertia")
    assert float(inertia.get("izz")) < 1.0
    assert any("link_3" in note for note in adapted.notes)
    assert any("joint_2" in note and "degrees" in note for note in adapted.notes)
    assert not any("link_1 " in note or "link_2 " in note for note in adapted.notes)
