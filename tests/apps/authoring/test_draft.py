"""`rtc cell new`: the first cell of an arm, from its URDF alone."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import msgspec
import numpy as np
import pinocchio as pin
import pytest

from rtc.apps.authoring import words_and_keys
from rtc.apps.authoring.draft import draft
from rtc.apps.authoring.hull import hull_of
from rtc.apps.authoring.pads import ABOVE_M, FAR_AWAY, hindrance
from rtc.apps.authoring.review import review
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Box, Frame, Object
from rtc.model.robot import hulls
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry
from tests.apps.authoring import small_arms
from tests.apps.authoring.conftest import ARMS, DATA


@pytest.mark.parametrize("arm", ARMS)
def test_the_first_cell_of_an_arm_has_no_fault(first_cell, arm):
    findings, cell = review(first_cell(arm))
    assert findings == []
    assert cell is not None
    assert [seat.name for seat in cell.seats] == ["PAD-1", "PAD-2"]


def test_an_arm_keeps_its_own_hand_and_gets_its_grasp_frame(panda_cell):
    """Between the fingers, z out of the palm, y along the way of the first finger; 7 mm from where its maker has it."""
    arm = panda_cell.arm("PANDA")
    assert arm.gripper.finger_joints == ("panda_finger_joint1", "panda_finger_joint2")
    assert arm.gripper.max_opening_m == pytest.approx(0.08)
    assert arm.sensor_joint is None
    own = ArmModel(panda_cell.urdf("PANDA"), joints=arm.joints, tcp_link="panda_grasptarget")
    ours = ArmModel(panda_cell.urdf("PANDA"), joints=arm.joints)
    assert geometry.distance(own.fk(arm.home_rad), ours.fk(arm.home_rad)) < 0.010
    assert geometry.angle(own.fk(arm.home_rad), ours.fk(arm.home_rad)) < 1e-6


def test_an_arm_without_a_hand_gets_one_that_points_away_from_it(first_cell):
    for name, before, last in (("IIWA", "lbr_iiwa_link_6", "lbr_iiwa_link_7"), ("XARM", "link5", "link6")):
        cell = Cell.load(first_cell(name))
        assert cell.arm(name).sensor_joint == "wrist_ft"
        model = pin.buildModelFromXML(cell.urdf(name))
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        at = {link: data.oMf[model.getFrameId(link)].translation for link in (before, last, "tcp")}
        assert np.linalg.norm(at["tcp"] - at[before]) > np.linalg.norm(at[last] - at[before]) + 0.10


@pytest.mark.parametrize("arm", ARMS)
def test_stow_is_compact_and_not_far_from_home(first_cell, arm):
    """No joint winds up, and the whole arm stays nearer to its base than at home."""
    cell = Cell.load(first_cell(arm))
    spec = cell.arm(arm)
    model = pin.buildModelFromXML(cell.urdf(arm))

    def extent_m(joints):
        q = np.zeros(model.nq)
        for name, value in zip(spec.joints, joints, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        return max(float(np.linalg.norm(place.translation)) for place in data.oMf)

    assert extent_m(spec.stow_rad) < 0.9 * extent_m(spec.home_rad)
    assert np.abs(np.subtract(spec.stow_rad, spec.home_rad)).max() < np.pi


def test_a_mounted_hand_has_colours_of_its_own(first_cell):
    """A picture of the cell must show where it points."""
    robot = ElementTree.fromstring(Cell.load(first_cell("IIWA")).urdf("IIWA"))
    for name in ("palm", "finger_a", "finger_b"):
        (visual,) = robot.findall(f"link[@name='{name}']/visual")
        assert visual.find("material/color") is not None


@pytest.mark.parametrize("kind", ["SIX", "FIVE", "SCARA", "PORTAL", "RIGHT", "BEHIND"])
def test_an_arm_gets_pads_that_it_reaches_from_above(small_file, kind):
    """Also one with fewer than six joints: in the attitude that its hand has there. And one whose front is not the x
    axis of its base."""
    findings, cell = review(small_file(kind))
    assert findings == []
    assert [seat.name for seat in cell.seats] == ["PAD-1", "PAD-2"]


def test_what_keeps_an_arm_from_its_pads_is_named(small_cell):
    """Weak motors, too: they were stated as places that the hand does not reach (PR2)."""
    cell = small_cell("SIX")
    assert not hindrance(cell, ABOVE_M)

    file = cell.arms[0].urdf
    weak = re.sub(r'effort="[^"]*"', 'effort="1"', cell.texts[file])
    assert "torque" in hindrance(msgspec.structs.replace(cell, texts={**cell.texts, file: weak}), ABOVE_M)

    far = [msgspec.structs.replace(seat, frame=Frame(xyz=(5.0, 0.0, 0.1))) for seat in cell.seats]
    assert hindrance(msgspec.structs.replace(cell, seats=far), ABOVE_M) == FAR_AWAY

    at = cell.seat("PAD-2").frame.xyz
    lid = Object(
        name="LID",
        kind="structure",
        fixed=True,
        mass_kg=1.0,
        shapes=[Box(name="lid", size_m=(0.2, 0.2, 0.01), frame=Frame(xyz=(at[0], at[1], at[2] + 0.1)))],
    )
    assert "LID" in hindrance(msgspec.structs.replace(cell, objects=[*cell.objects, lid]), ABOVE_M)


@pytest.mark.parametrize("kind", ["SIX", "FIVE", "SCARA", "PORTAL"])
def test_the_fingers_close_on_two_sides_of_the_cube(small_cell, kind):
    """Whatever yaw the hand has there: across the corners it would be too wide."""
    cube = small_cell(kind).object("CUBE")
    (point,) = cube.grasp_points
    closing = geometry.rotate(point.frame.pose, (0.0, 1.0, 0.0))
    assert float(np.abs(closing) @ cube.shapes[0].size_m) == pytest.approx(point.width_m)


def test_a_joint_with_the_name_of_its_link_is_renamed(tmp_path):
    file = tmp_path / "six.urdf"
    file.write_text(small_arms.urdf("six", small_arms.SIX, finger_kg=0.1, same_names=True))
    found = draft(file, "SIX")
    assert found.cell.arms[0].joints == [f"link_{n}_joint" for n in range(1, 7)]
    assert sum("has the name of a link" in note for note in found.notes) == 6


@pytest.mark.parametrize("name", ["A B", "1", "MOVE", "my-arm"])
def test_a_name_that_no_sentence_can_use_is_refused(name):
    with pytest.raises(ProgramError, match=f"--name {name}: "):
        draft(ARMS["IIWA"][0], name)


def test_a_robot_with_the_name_of_a_word_of_the_language_gets_another_one(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(small_arms.urdf("arm", small_arms.SIX))
    assert draft(file).cell.arms[0].name == "ARM-1"


def test_the_same_urdf_gives_the_same_cell(first_cell):
    urdf, tip = ARMS["PANDA"]
    assert draft(urdf, "PANDA", tip).yaml == first_cell("PANDA").read_text()


def test_its_document_needs_no_mesh_file(panda_cell, tmp_path):
    alone = Cell.from_bytes(panda_cell.encode())
    posture = dict.fromkeys(["PANDA"], panda_cell.arm("PANDA").home_rad)
    assert CollisionWorld(alone).check(posture) is None


def test_impossible_and_implausible_inertias_are_replaced(first_cell):
    """A simulator would take zero for the one, and a wrist of half a kg m2 for the other."""
    for name in ("PANDA", "XARM"):
        cell = Cell.load(first_cell(name))
        for inertia in ElementTree.fromstring(cell.urdf(name)).iter("inertia"):
            value = {key: float(inertia.get(key)) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")}
            a, b, c = np.linalg.eigvalsh(
                [
                    [value["ixx"], value["ixy"], value["ixz"]],
                    [value["ixy"], value["iyy"], value["iyz"]],
                    [value["ixz"], value["iyz"], value["izz"]],
                ]
            )
            assert a > 0
            assert a + b > c * (1 - 1e-6)


def test_a_hull_has_few_vertices_and_keeps_to_the_mesh():
    ball = np.random.default_rng(0).normal(size=(4000, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1)[:, None]
    hull = hull_of(ball, "ball")
    assert hull.left_out_m < 0.004  # a ball is the worst shape for a hull with few vertices
    solid = hulls.convex(hull.text)
    assert solid.num_points < 250
    assert solid.computeVolume() == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='a'><link name='b'/>", "is not XML"),
        ("<sdf/>", "is not a URDF"),
        ("<robot name='a'><link name='b'/><link name='c'/></robot>", "one root link is needed"),
        ("<robot name='a'><link name='b'/></robot>", "no joint that moves"),
        ("<robot name='a'/>", "there are no links"),
    ],
)
def test_a_file_that_is_not_an_arm_is_refused_with_the_reason(tmp_path, text, words):
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    with pytest.raises(ProgramError, match=words):
        draft(file)


def test_a_hand_that_does_not_slide_is_refused_with_the_way_out():
    with pytest.raises(ProgramError, match="--tip"):
        draft(DATA / "xarm" / "xarm6_with_gripper.urdf")


def test_a_missing_mesh_is_named(tmp_path):
    file = tmp_path / "panda.urdf"
    file.write_text(ARMS["PANDA"][0].read_text())
    with pytest.raises(ProgramError, match=r"mesh package://meshes/collision/link0\.obj is not found"):
        draft(file)


@pytest.mark.parametrize("name", ["C-1", "C-007", "LAST", "N", "MM", "HERE", "ALL", "WORLD", "UNKNOWN", "RESOURCES"])
def test_a_word_with_a_meaning_of_its_own_is_no_name(name: str) -> None:
    rows = list(words_and_keys.faults({"objects": [{"name": name}, {"name": f"{name}-BOX"}]}))
    assert [(where, severity) for where, _, severity, _ in rows] == [("objects[0].name", "error")]
