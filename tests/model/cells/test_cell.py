"""The cell: what comes along loads whole, travels as one document, and errors name their place."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.model.cells import model_checks
from rtc.model.cells.cell import CELLS, Cell
from rtc.model.cells.parts import Camera
from rtc.protocol.outcomes import ProgramError
from rtc.spatial import geometry


@pytest.fixture(scope="module")
def swapout():
    return Cell.load("swapout")


@pytest.fixture
def plain():
    """The default cell as plain data, to be spoilt."""
    return msgspec.yaml.decode((CELLS / "swapout" / "cell.yaml").read_bytes())


def load(tmp_path, plain):
    for model in (CELLS / "swapout").glob("puma560.*"):
        (tmp_path / model.name).write_text(model.read_text())
    file = tmp_path / "cell.yaml"
    file.write_bytes(msgspec.yaml.encode(plain))
    return Cell.load(file)


def test_one_document_holds_everything(swapout):
    again = Cell.from_bytes(swapout.encode())
    assert again == swapout
    assert again.digest() == swapout.digest()
    assert "<robot" in again.urdf("LEFT-ARM")


def test_a_document_without_its_models_is_refused(swapout):
    bare = msgspec.structs.replace(swapout, texts={})
    with pytest.raises(ProgramError, match=r"\$\.arms\[0\]\.urdf: the text of puma560\.urdf is not embedded"):
        Cell.from_bytes(bare.encode())


def test_the_digest_changes_with_a_model(swapout):
    texts = {**swapout.texts, "puma560.urdf": swapout.texts["puma560.urdf"] + "\n"}
    assert msgspec.structs.replace(swapout, texts=texts).digest() != swapout.digest()


def test_a_seated_object_is_where_its_seat_is(swapout):
    assert np.allclose(swapout.object_pose("MACS-NEW"), (0.8, -0.8, 0.6, 0, 0, 0, 1))
    handle = swapout.object("MACS-NEW").grasp_point("HANDLE-A")
    tcp = geometry.compose(swapout.object_pose("MACS-NEW"), handle.frame.pose)
    assert np.allclose(tcp, (0.65, -0.885, 0.6, *geometry.LEVEL))


def test_a_path_a_folder_and_a_name_load_alike(swapout):
    assert Cell.load(CELLS / "swapout") == Cell.load(CELLS / "swapout" / "cell.yaml") == swapout


def test_a_folder_without_a_cell_does_not_hide_a_cell_of_the_project(swapout, tmp_path, monkeypatch):
    (tmp_path / "swapout").mkdir()
    monkeypatch.chdir(tmp_path)
    assert Cell.load("swapout").name == swapout.name


def test_an_unknown_cell_names_those_that_come_along():
    with pytest.raises(ProgramError, match=r"no cell nowhere.*swapout"):
        Cell.load("nowhere")


def test_a_file_of_another_kind_is_not_a_cell(tmp_path):
    (tmp_path / "lift.yaml").write_text("script: lift\ncase: 1\n")
    with pytest.raises(ProgramError, match=r"lift\.yaml is not a cell: .*`script`; a cell has arms, "):
        Cell.load(tmp_path / "lift.yaml")


def test_a_region_knows_what_is_inside(swapout):
    region = swapout.region("BAY-2-RANGE")
    assert region.contains((0.55, 0.0, 0.75))
    assert not region.contains((0.55, 0.0, 1.16))


def spoil_seat(cell):
    cell["objects"][1]["seat"] = "RACK-9"


def spoil_twice_seated(cell):
    cell["objects"][1]["seat"] = "RACK-1"


def spoil_name(cell):
    cell["places"][0]["name"] = "MACS-NEW"


def spoil_shape(cell):
    cell["objects"][0]["shapes"][2]["size_m"] = [0.1, -0.1, 0.1]


def spoil_shape_name(cell):
    cell["seats"][0]["shapes"][1]["name"] = "floor"


def spoil_joints(cell):
    cell["arms"][1]["home_deg"] = [0, 0]


def spoil_place_joints(cell):
    cell["places"][0]["joints_deg"] = {"LEFT-ARM": [1, 2, 3]}


def spoil_place_arm(cell):
    cell["places"][0]["poses"]["MIDDLE-ARM"] = {"xyz": [0, 0, 1]}


def spoil_field(cell):
    cell["objects"][0]["mas_kg"] = 3


def spoil_way_out(cell):
    cell["seats"][2]["way_out"] = [1, 1, 0]


def spoil_catch(cell):
    cell["seats"][2] |= {"detent_n": 0.4, "detent_nm": 0.5}


def spoil_urdf(cell):
    cell["arms"][1]["urdf"] = "puma999.urdf"


def spoil_camera_arm(cell):
    cell["cameras"][1]["arm"] = "MIDDLE-ARM"


def spoil_camera_name(cell):
    cell["cameras"][0]["name"] = "RACK-1"


def spoil_camera_attitude(cell):
    cell["cameras"][0] |= {"xyz": [0.8, -0.8, 2.0], "looks_at": [0.8, -0.8, 0.6]}


def spoil_camera_size(cell):
    cell["cameras"][2]["size_px"] = [640, 0]


def spoil_tag_body(cell):
    cell["tags"][3]["body"] = "RIGHT-ARM"


def spoil_tag_id(cell):
    cell["tags"][3]["id"] = 1


def spoil_tag_family(cell):
    cell["tags"][3]["id"] = 587


@pytest.mark.parametrize(
    ("spoil", "place"),
    [
        (spoil_camera_arm, "$.cameras[1].arm: there is no arm MIDDLE-ARM; there are LEFT-ARM, RIGHT-ARM"),
        (spoil_camera_name, "$.cameras[0].name: RACK-1 is already the name of $.seats[0]"),
        (spoil_camera_attitude, "$.cameras[0].looks_at: CAMERA-1 has no attitude"),
        (spoil_camera_size, "$.cameras[2].size_px[1]"),
        (spoil_tag_body, "$.tags[3].body: there is no seat or object RIGHT-ARM; there are BAY-2, MACS-NEW"),
        (spoil_tag_id, "$.tags[3].id: 1 is already the id of $.tags[1]"),
        (spoil_tag_family, "$.tags[3].id"),
        (spoil_seat, "$.objects[1].seat: there is no seat RACK-9; there are BAY-2, RACK-1, RACK-2"),
        (spoil_twice_seated, "$.objects[1].seat: RACK-1 already holds MACS-NEW"),
        (spoil_name, "$.places[0].name: MACS-NEW is already the name of $.objects[0]"),
        (spoil_shape, "$.objects[0].shapes[2].size_m[1]"),
        (spoil_shape_name, "$.seats[0].shapes[1].name: floor is used twice"),
        (spoil_joints, "$.arms[1].home_deg: 6 joints need as many values"),
        (spoil_place_joints, "$.places[0].joints_deg.LEFT-ARM: 6 joints need as many values"),
        (spoil_place_arm, "$.places[0].poses.MIDDLE-ARM: there is no arm MIDDLE-ARM; there are LEFT-ARM, RIGHT-ARM"),
        (spoil_field, "$.objects[0]"),
        (spoil_way_out, "$.seats[2].way_out: must be of unit length"),
        (spoil_catch, "$.seats[2].detent_nm"),
        (spoil_urdf, "$.arms[1].urdf: cannot read puma999.urdf"),
        (lambda p: p.update(name=""), "name"),
        (lambda p: p.update(gravity_m_s2=[0.0, 0.0, -1e300]), "gravity_m_s2"),
        (lambda p: p["objects"][0].update(mass_kg=2000.0), "$.objects[0].mass_kg"),
        (lambda p: p["objects"][0].update(inertia_kg_m2=[1.0, 1.0, 1e6]), "$.objects[0].inertia_kg_m2"),
        (lambda p: p["seats"][0]["frame"].update(xyz=[1e300, 0.0, 0.0]), "seats[0].frame"),
        (lambda p: p["seats"][0]["frame"].update(rpy_deg=[0.0, 1e9, 0.0]), "seats[0].frame"),
        (lambda p: p["objects"][0]["grasp_points"][0]["frame"].update(xyz=[0.0, 0.0, 1e6]), "grasp_points[0].frame"),
    ],
)
def test_an_error_names_its_place(tmp_path, plain, spoil, place):
    spoil(plain)
    with pytest.raises(ProgramError) as raised:
        load(tmp_path, plain)
    assert place in str(raised.value)


def test_a_camera_looks_along_its_axis_with_the_right_side_up():
    camera = Camera(name="CAMERA-9", xyz=(1.0, 2.0, 3.0), looks_at=(4.0, 2.0, 3.0))
    seen = geometry.transform_point(geometry.inverse(camera.pose), (4.0, 1.5, 3.25))
    assert np.allclose(seen, (0.5, -0.25, 3.0))  # to the right, above, in front


# --- the models of arms --------------------------------------------------------------------------------


def test_the_models_of_the_default_cell_fit_it(swapout):
    assert list(model_checks.problems(swapout.arms, swapout.texts)) == []


SLIDE_A = '<joint name="finger_a_slide" type="prismatic">'
FOUR = ("joints", "home_deg", "stow_deg", "acceleration_deg_s2")
PALM = '<joint name="palm_mount" type="fixed">'


def hand(**fields):
    return lambda arm: arm["gripper"].update(fields)


#: change of the first arm, or of the text of its model; the resulting problem
MISFITS = {
    "joint": (
        lambda arm: arm["joints"].__setitem__(2, "elbow"),
        None,
        r"0\]\.joints: .*no joint elbow; there are finger_a",
    ),
    "order": (lambda arm: arm["joints"].reverse(), None, r"\.joints: .*the joints that move tcp are joint_1, joint_2"),
    "too few": (lambda arm: arm.update({k: arm[k][:5] for k in FOUR}), None, r"\.joints: .*move tcp are joint_1"),
    "tcp": (lambda arm: arm.update(tcp_link="tool0"), None, r"\.tcp_link: .*there is no link tool0"),
    "sensor": (lambda arm: arm.update(sensor_joint="ft"), None, r"\.sensor_joint: .*there is no joint ft"),
    "moving sensor": (lambda arm: arm.update(sensor_joint="joint_6"), None, r"\.sensor_joint: .*joint_6 is revolute"),
    "palm": (hand(palm_link="hand"), None, r"gripper\.palm_link: .*no link hand"),
    "fingers": (hand(finger_joints=["left", "right"]), None, r"gripper\.finger_joints: .*there is no joint left"),
    "crossed": (hand(finger_links=["finger_b", "finger_a"]), None, r"finger_a_slide carries finger_a, not finger_b"),
    "narrow": (hand(max_opening_m=0.2), None, r"max_opening_m: .*goes from 0 to 0\.04 m"),
    "revolute": (None, (SLIDE_A, SLIDE_A.replace("prismatic", "revolute")), r"finger_a_slide is revolute"),
    "same way": (None, ('<axis xyz="0 -1 0"/>', '<axis xyz="0 1 0"/>'), "do not move in opposite directions"),
    "third": (None, (PALM, PALM.replace("fixed", "continuous")), "palm_mount"),
    "home": (
        lambda arm: arm["home_deg"].__setitem__(4, 120),
        None,
        r"home_deg: .*joint_5 is at 120 deg.* -100\.0 and 100",
    ),
    "stow": (lambda arm: arm["stow_deg"].__setitem__(0, -170), None, r"stow_deg: .*joint_1 is at -170 deg"),
    "mesh": (
        None,
        ('<box size="0.05 0.11 0.06"/>', '<mesh filename="package://palm.stl"/>'),
        r"package://palm\.stl is not found",
    ),
    "one name": (None, ('joint name="palm_mount"', 'joint name="flange"'), "a link and a joint have the name flange"),
    "no XML": (None, ("</robot>", ""), "is not XML"),
}


@pytest.mark.parametrize("kind", MISFITS)
def test_a_model_that_does_not_fit_its_cell_is_refused_when_it_is_loaded(tmp_path, plain, kind):
    change, texts, words = MISFITS[kind]
    if change:
        change(plain["arms"][0])
    for model in (CELLS / "swapout").glob("puma560.*"):
        (tmp_path / model.name).write_text(model.read_text().replace(*(texts or ("", ""))))
    file = tmp_path / "cell.yaml"
    file.write_bytes(msgspec.yaml.encode(plain))
    with pytest.raises(ProgramError, match=words):
        Cell.load(file)
