"""URDF files of other people: what is odd in them is mended with a note, or refused with its cause."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from rtc.apps.authoring import draft as drafts
from rtc.apps.authoring import self_collisions
from rtc.apps.authoring.adapt import adapt, words
from rtc.apps.authoring.review import review
from rtc.apps.cli import main
from rtc.drawing import renderer
from rtc.model.cells import two_readers
from rtc.protocol.outcomes import ProgramError
from rtc.subsystems.motion.executor import Executor
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.readers import differences
from sim_mcm.period import period
from tests.apps.authoring import small_arms

HAND = {"finger_kg": 0.1}


def six(*changes, hand=True):
    """The text of an arm with six joints, with and without a parallel hand, after changes (before, after) of it."""
    text = small_arms.urdf("six", small_arms.SIX, **(HAND if hand else {}))
    for before, after in changes:
        assert before in text, before
        text = text.replace(before, after, 1)
    return text


def adapted(folder, text, tip=""):
    file = folder / "arm.urdf"
    file.write_text(text)
    return adapt(file, "hulls", tip)


# --- both readers --------------------------------------------------------------------------------------

LINK_2 = '<link name="link_2">\n    <inertial><origin xyz="0 0 0.175"/><mass value="4.0"/>'
#: what one reader leaves out, or reads otherwise -> the element that is named
READ_OTHERWISE = {
    "joint joint_2": ('<axis xyz="0 1 0"/>', '<axis xyz="0 1.5 0"/>'),
    "link link_2": (LINK_2, LINK_2.replace('mass value="4.0"', 'mass value="0"')),
    "link link_1": ('ixx="0.018833333"', 'ixx="0.3"'),
}


def test_both_readers_read_a_sound_arm_alike():
    assert differences(six(), {}) == []
    assert differences(small_arms.urdf("portal", small_arms.PORTAL), {}) == []


def test_the_mass_and_length_and_turn_of_every_value_is_read_alike():
    """Values that a file may well have: rotated inertias, a tensor with products, axes askew, limits of any sign."""
    text = six(
        ('<inertial><origin xyz="0 0 0.175"/>', '<inertial><origin xyz="0.01 0 0.175" rpy="0.3 0.2 0.9"/>'),
        ('ixy="0" ixz="0" iyz="0"', 'ixy="0.002" ixz="-0.001" iyz="0.003"'),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0.6 0.8 0"/>'),
        ('<origin xyz="0 0 0.35"/>', '<origin xyz="0 0 0.35" rpy="1.2 -0.4 4"/>'),
    )
    assert differences(text, {}) == []


@pytest.mark.parametrize("where", READ_OTHERWISE)
def test_what_they_read_differently_names_its_element(where):
    found = differences(six(READ_OTHERWISE[where]), {})
    assert [one.where for one in found] == [where]
    assert "pinocchio" in found[0].problem


def test_a_check_compares_them(tmp_path):
    """A mass of the hand that is lost in one reader is an error, in a URDF by itself and in a cell."""
    file = tmp_path / "arm.urdf"
    file.write_text(six(READ_OTHERWISE["link link_2"]))
    assert {one.where for one in review(file)[0] if one.severity == "error"} == {"link link_2"}


# --- hands ---------------------------------------------------------------------------------------------

JAW = """<link name="{link}"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0"
iyz="0"/></inertial><collision><origin xyz="0 0.02 0.04"/><geometry><box size="0.02 0.01 0.08"/></geometry></collision>
</link><joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{link}"/><origin xyz="0 0.02 0.04"/>
<axis xyz="1 0 0"/><limit lower="0" upper="{upper}" effort="5" velocity="1"/></joint></robot>"""


def jaw(text, joint, upper=1.2, parent="link_6", link="part"):
    return text.replace("</robot>", JAW.format(joint=joint, upper=upper, parent=parent, link=link))


@pytest.mark.parametrize(("joint", "upper"), [("joint_7", 1.2), ("jointGripper", 3.0), ("jaw-turn", 1.2)])
def test_a_jaw_is_no_joint_of_the_arm(joint, upper, tmp_path):
    """By its name or, if that tells nothing, by the little that it turns."""
    text = jaw(six(hand=False), joint, upper)
    with pytest.raises(ProgramError, match=r"--tip link_6") as refused:
        adapted(tmp_path, text)
    assert joint in str(refused.value)
    assert adapted(tmp_path, text, "link_6").joints == [f"joint_{n}" for n in range(1, 7)]


def test_two_fingers_that_turn_are_a_hand_that_is_not_understood(tmp_path):
    text = jaw(jaw(six(hand=False), "joint_7", 3.0), "joint_8", 3.0, link="other")
    with pytest.raises(ProgramError, match=r"joint_7, joint_8 may be a hand.*--tip link_6"):
        adapted(tmp_path, text)


def test_a_name_of_the_whole_robot_says_nothing_of_its_last_joint(tmp_path):
    text = six(hand=False).replace('name="joint_', 'name="gripper_arm_')
    assert len(adapted(tmp_path, text).joints) == 6


SAME_WAY = ('<axis xyz="0 -1 0"/>\n    <limit lower="0.0" upper="0.04"', '<axis xyz="0 1 0"/>\n    <limit {limits}')


def test_a_finger_that_opens_with_negative_values_is_turned_round(tmp_path):
    """The same motion, written otherwise: both readers and the hand need positive values."""
    before, after = SAME_WAY
    arm = adapted(tmp_path, six((before, after.format(limits='lower="-0.04" upper="0"'))))
    assert arm.fingers == ("left_slide", "right_slide")
    assert arm.robot.limits("right_slide") == (0.0, 0.04)
    assert arm.robot.axis("right_slide").tolist() == [0.0, -1.0, 0.0]
    assert any("right_slide opens with negative values" in note for note in arm.notes)


def test_fingers_that_move_the_same_way_are_a_hand_that_is_not_understood(tmp_path):
    before, after = SAME_WAY
    with pytest.raises(ProgramError, match=r"left_slide, right_slide may be a hand.*--tip hand"):
        adapted(tmp_path, six((before, after.format(limits='lower="0" upper="0.04"'))))


def test_a_joint_of_the_arm_that_mimics_another_is_refused(tmp_path):
    """It got a motor of its own, which the arm has not."""
    text = six(('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="joint_1"/>'))
    with pytest.raises(ProgramError, match=r"joint_2 mimics joint_1.*--tip"):
        adapted(tmp_path, text)


def test_two_arms_are_no_hand(tmp_path):
    """Which of them, only the user knows."""
    one = six(hand=False)
    body = re.sub(r'name="(link|joint)_', r'name="other_\1_', one)
    body = re.sub(r' link="link_', ' link="other_link_', body)
    body = body.replace('<robot name="six">', "").partition("</link>")[2]
    text = one.replace("</robot>", body)
    with pytest.raises(ProgramError, match=r"2 chains of joints.*--tip: link_6, other_link_6"):
        adapted(tmp_path, text)
    assert adapted(tmp_path, text, "link_6").joints == [f"joint_{n}" for n in range(1, 7)]


# --- guesses by names ----------------------------------------------------------------------------------


def test_words_of_a_name_are_whole():
    assert words("left_mount") == ["left", "mount"]
    assert words("wristFTSensor") == ["wrist", "ft", "sensor"] or words("wristFTSensor") == ["wrist", "fts", "ensor"]
    assert words("LFinger13.a-FORCE") == ["l", "finger", "a", "force"]


@pytest.mark.parametrize(
    ("mount", "sensor"), [("left_mount", None), ("lift_joint", None), ("wristFT", "wristFT"), ("ft_300", "ft_300")]
)
def test_a_wrist_sensor_is_named_by_a_whole_word(mount, sensor, tmp_path):
    arm = adapted(tmp_path, six(('"hand_mount"', f'"{mount}"')))
    assert arm.sensor == sensor
    assert sensor is None or any(f"{mount} is taken for the wrist sensor" in note for note in arm.notes)


def test_a_sensor_at_the_shoulder_is_no_wrist_sensor(tmp_path):
    base = '<link name="base">'
    mount = '<joint name="base_ft" type="fixed"><parent link="world"/><child link="base"/></joint>'
    assert adapted(tmp_path, six((base, f'<link name="world"/>{mount}{base}'))).sensor is None


# --- causes that a file has ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ('<robot name="a" xmlns:xacro="http://x/xacro"><xacro:include filename="b"/></robot>', "expand it first"),
        ('<robot name="a"><xacro:include filename="b"/></robot>', "expand it first"),
        ('<robot name="${name}"/>', "expand it first"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n", "git lfs pull"),
    ],
)
def test_a_file_that_is_not_a_urdf_yet_has_its_cause(text, cause, tmp_path):
    with pytest.raises(ProgramError, match=cause):
        adapted(tmp_path, text)
    (finding,) = review(tmp_path / "arm.urdf")[0]
    assert cause in finding.problem


TETRAHEDRON = "v 0 0 0\nv {a} 0 0\nv 0 {a} 0\nv 0 0 {a}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit name="millimeter"
meter="0.001"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh><source id="p"><float_array
id="a" count="12">0 0 0 80 0 0 0 80 0 0 0 80</float_array><technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="4"><input
semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def with_mesh(name, scale=""):
    box = '<box size="0.06 0.06 0.03"/></geometry></collision>\n  </link>\n  <joint name="hand_mount"'
    assert box in six()
    return six((box, box.replace('<box size="0.06 0.06 0.03"/>', f'<mesh filename="{name}"{scale}/>')))


@pytest.mark.parametrize(
    ("content", "scale", "cause"),
    [
        ("version https://git-lfs.github.com/spec/v1\n", "", "git lfs pull"),
        (TETRAHEDRON.format(a=80), "", "if it is in mm"),
        (TETRAHEDRON.format(a=0.08), ' scale="0.001 0.001 0.001"', "it needs no scale"),
    ],
)
def test_a_mesh_that_cannot_be_meant_has_its_cause(content, scale, cause, tmp_path):
    (tmp_path / "part.obj").write_text(content)
    with pytest.raises(ProgramError, match=cause):
        adapted(tmp_path, with_mesh("part.obj", scale))
    (finding,) = (one for one in review(tmp_path / "arm.urdf")[0] if one.severity == "error")
    assert finding.where == "link link_6"
    assert cause in finding.problem


def test_the_unit_of_a_collada_file_counts(tmp_path):
    """The library that reads it leaves the unit out: a flange of 80 mm was 80 m long."""
    (tmp_path / "part.dae").write_text(DAE)
    arm = adapted(tmp_path, with_mesh("part.dae"))
    (hull,) = arm.hulls.values()
    assert max(float(word) for line in hull.splitlines() if line[0] == "v" for word in line.split()[1:]) == 0.08


def test_soft_limits_are_kept(tmp_path):
    """No process here keeps a <safety_controller>: its limits become those of the joint."""
    soft = '<safety_controller k_velocity="1" soft_lower_limit="-1.5" soft_upper_limit="9"/><axis xyz="0 1 0"/>'
    text = six(('<axis xyz="0 1 0"/>', soft))
    arm = adapted(tmp_path, text)
    assert arm.robot.limits("joint_2") == (-1.5, 2.0)
    assert any("soft limits of joint_2" in note for note in arm.notes)
    (finding,) = review(tmp_path / "arm.urdf")[0]
    assert (finding.severity, finding.where) == ("warning", "joint joint_2")


def test_a_material_without_a_name_gets_one(tmp_path):
    text = six(("<collision>", "<visual><geometry><box size='1 1 1'/></geometry><material/></visual><collision>"))
    assert adapted(tmp_path, text).robot.links["base"].find("visual/material").get("name")


# --- the mounted hand, motors and pads -----------------------------------------------------------------


def towards(arm):
    """The direction of the mounted hand, in the axes of the last link."""
    return np.round(arm.robot.placement("wrist_ft")[:3, 2], 3).tolist()


FRAME = """<link name="frame"><inertial><mass value="0.1"/>
  <inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="frame_mount" type="fixed"><parent link="link_6"/><child link="frame"/></joint>"""
FLANGE = '<origin xyz="0 0 0.025"/><geometry><box size="0.06 0.06 0.03"/></geometry>'
FOREARM = '<origin xyz="0 0 0.05"/><geometry><box size="0.06 0.06 0.08"/></geometry>'


@pytest.mark.parametrize(
    ("flange", "forearm", "direction"),
    [
        ("0 0 0.025", "0 0 0.05", [0.0, 0.0, 1.0]),
        ("0 0 0.15", "0 0 0.11", [0.0, 0.0, 1.0]),  # the body before it reaches beyond the origin of the flange
        ("0 0 -0.15", "0 0 0.05", [0.0, 0.0, -1.0]),  # the axis of the last joint points back
        ("0 0.08 0", "0 0 0.05", [0.0, 1.0, 0.0]),  # the last joint bends the link
    ],
)
def test_a_mounted_hand_points_where_the_last_link_does(flange, forearm, direction, tmp_path):
    """It pointed back into arms whose wrist is longer than their flange is far."""
    text = six(
        (FLANGE, FLANGE.replace("0 0 0.025", flange, 1)), (FOREARM, FOREARM.replace("0 0 0.05", forearm, 1)), hand=False
    )
    assert towards(adapted(tmp_path, text)) == direction


def test_motors_that_a_file_leaves_out_carry_the_arm(tmp_path):
    """An arm of 1.3 t had motors of 50 N.m, as one of 13 kg."""
    text = six(hand=False).replace(' effort="100.0"', "").replace(' effort="150.0"', "")
    heavy = re.sub(r'mass value="([0-9.]+)"', lambda found: f'mass value="{100 * float(found[1])}"', text)
    efforts = [
        float(adapted(tmp_path, one).robot.joints["joint_2"].find("limit").get("effort")) for one in (text, heavy)
    ]
    assert 50.0 <= efforts[0] < 400.0
    assert efforts[1] > 5000.0


@pytest.mark.parametrize("factor", [0.55, 0.65])
def test_a_small_arm_gets_its_pads(factor, tmp_path, monkeypatch):
    """20 cm of free line above the place before it, and above each pad, is more than a reach of 0.7 m has."""
    monkeypatch.setattr(drafts, "POSTURES", 400)
    monkeypatch.setattr(self_collisions, "SAMPLES", 250)
    file = tmp_path / "arm.urdf"
    file.write_text(small_arms.urdf("small", [small_arms.scaled(joint, factor) for joint in small_arms.SIX]))
    made = drafts.draft(file, "UNIT")
    assert [seat.name for seat in made.cell.seats] == ["PAD-1", "PAD-2"]
    assert not any("no pads" in note for note in made.notes)


def test_links_without_a_mass_get_one_by_their_size(tmp_path):
    """Bullet took another one than pinocchio, which refused the arm for its accelerations."""
    bare = re.sub(r"<inertial>.*?</inertial>", "", six(hand=False), flags=re.DOTALL)
    made = adapted(tmp_path, bare)
    masses = [float(made.robot.links[f"link_{n}"].find("inertial/mass").get("value")) for n in range(1, 7)]
    volumes = [np.prod(joint.size) for joint in small_arms.SIX]
    assert masses == pytest.approx([1000.0 * volume for volume in volumes], rel=0.01)
    assert any("no mass is given for link_1" in note for note in made.notes)
    assert faults(tmp_path, made) == []


@pytest.mark.parametrize("zero", ["ixx", "ixx iyy izz"])
def test_a_mass_without_moments_gets_some(zero, tmp_path):
    """`rtc cell new` wrote a cell that `rtc cell check` refused."""
    text = six(("</robot>", f"{FRAME}</robot>"), hand=False)
    for key in zero.split():
        text = text.replace(f'{key}="1e-6"', f'{key}="0"')
    assert faults(tmp_path, adapted(tmp_path, text, "frame")) == []


def faults(folder, made):
    """The errors of the adapted model."""
    (folder / "made.urdf").write_text(made.urdf)
    return [one for one in review(folder / "made.urdf")[0] if one.severity == "error"]


def test_a_cell_that_its_check_would_refuse_is_not_written(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(six(("</robot>", f"{FRAME}</robot>"), ('<mass value="0.1"', '<mass value="-0.1"'), hand=False))
    with pytest.raises(ProgramError, match="link frame"):
        drafts.draft(file, "UNIT", "frame")


def test_an_arm_whose_hand_points_down_below_its_base_only_gets_a_stand(tmp_path, monkeypatch):
    monkeypatch.setattr(drafts, "POSTURES", 400)
    monkeypatch.setattr(drafts, "TABLES_M", (0.0,))
    monkeypatch.setattr(self_collisions, "SAMPLES", 250)
    joints = [small_arms.scaled(joint, 0.4) for joint in small_arms.SIX]
    joints[0] = joints[0]._replace(size=(0.06, 0.06, 0.04), middle=(0.0, 0.0, 0.02))
    joints[1] = joints[1]._replace(at=(0.0, 0.0, 0.04))
    file = tmp_path / "arm.urdf"
    file.write_text(small_arms.urdf("small", joints))
    made = drafts.draft(file, "UNIT")
    assert [seat.name for seat in made.cell.seats] == ["PAD-1", "PAD-2"]
    assert made.cell.arms[0].base.xyz[2] > 0.0
    assert any(thing.name == "STAND" for thing in made.cell.objects)


def test_a_body_that_reaches_below_the_base_is_no_collision_with_the_floor(tmp_path, monkeypatch):
    """Every posture collided, so the arm was refused."""
    monkeypatch.setattr(drafts, "POSTURES", 200)
    monkeypatch.setattr(self_collisions, "SAMPLES", 250)
    file = tmp_path / "arm.urdf"
    low = small_arms.SIX[0]._replace(size=(0.06, 0.06, 0.35), middle=(0.0, 0.0, 0.05))  # 75 mm below
    file.write_text(small_arms.urdf("low", [low, *small_arms.SIX[1:]]))
    assert 0.08 < drafts.draft(file, "UNIT").cell.arms[0].base.xyz[2] < 0.11


def test_a_cell_whose_readers_differ_is_not_written(tmp_path, monkeypatch):
    differing = [two_readers.ReaderDifference("joint j", "its axis differs", "one axis")]
    monkeypatch.setattr(two_readers, "differences", lambda *_, **__: differing)
    file = tmp_path / "arm.urdf"
    file.write_text(six())
    with pytest.raises(ProgramError, match="joint j: its axis differs; expected: one axis"):
        drafts.draft(file, "UNIT")


def test_findings_are_printed_when_the_renderer_is_late(tmp_path, monkeypatch, capsys):
    """They were not: the error of the picture came first."""
    monkeypatch.setattr(renderer, "LIMIT_S", 0.0)
    monkeypatch.setattr(renderer, "END_S", 0.0)
    monkeypatch.setattr(sys, "argv", ["rtc", "cell", "check", "panda", "-o", str(tmp_path / "a.png")])
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert not ended.value.code
    out = " ".join(capsys.readouterr().out.split())
    assert "0 errors" in out
    assert "no picture: " in out


@pytest.mark.physics
@pytest.mark.parametrize("origin", ['xyz="0.01 0.02 0.05"', 'xyz="0.01 0.02 0.05" rpy="0.5 0.3 1"'])
def test_a_sensor_whose_link_has_its_mass_elsewhere_feels_nothing_at_rest(origin, tmp_path, monkeypatch):
    """The simulator states what it feels in the axes of the inertia: 6 N and 0.3 N.m were felt in the air."""
    monkeypatch.setattr(drafts, "POSTURES", 300)
    monkeypatch.setattr(self_collisions, "SAMPLES", 150)
    hand = '<inertial><origin xyz="0 0 0"/><mass value="0.5"/>'
    file = tmp_path / "arm.urdf"
    file.write_text(six(('"hand_mount"', '"ft_300"'), (hand, hand.replace('xyz="0 0 0"', origin))))
    sim = BulletCell(drafts.draft(file, "UNIT").cell)
    try:
        executor = Executor(sim.arms["UNIT"])
        for tick in range(200):
            period(executor.tick, sim, 1e-3 * tick)
        assert np.linalg.norm(executor.sample.wrench[:3]) < 0.2
        assert np.linalg.norm(executor.sample.wrench[3:]) < 0.02
    finally:
        sim.close()
