"""What is believed of the scene, from facts and measurements, and how far it is from the truth."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from rtc.apps.cli.look import differs, in_words, picture
from rtc.drawing.scene import believed, centimetres, degrees, request_camera
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera
from rtc.protocol import messages as m
from rtc.spatial import geometry, hinges
from rtc.world.model import initial_facts

HAND = geometry.from_rpy((0.5, -0.2, 0.9), (0, math.pi / 2, 0)).tolist()
GRASP = [0.0, 0.085, 0.15, 0.0, 0.0, 0.0, 1.0]  # of the module, in tcp axes


@pytest.fixture
def facts(cell: Cell) -> dict[str, m.Fact]:
    return {change.key: fact(change.key, change.value) for change in initial_facts(cell)}


def fact(key: str, value: Any, validity: m.Validity = m.Validity.VALID) -> m.Fact:
    return m.Fact(key=key, value=value, validity=validity, version=1, source="cell", at_s=0.0)


def sample(primitive: str = "") -> m.ArmSample:
    return m.ArmSample(
        joints=[0.1] * 6, velocities=[0.0] * 6, wrench=[0.0] * 6, tcp_pose=HAND, hand_width_m=0.02, primitive=primitive
    )


def truth(cell: Cell, held: dict[str, list[str]], **moved: list[float]) -> m.SimTruthReply:
    poses = {thing.name: cell.object_pose(thing.name).tolist() for thing in cell.objects}
    poses |= {name.replace("_", "-"): pose for name, pose in moved.items()}
    return m.SimTruthReply(request="1", sim_s=0.0, poses=poses, velocities={}, tcp={}, joints={}, fingers={}, held=held)


def test_what_is_held_is_where_its_hand_is_measured(cell: Cell, facts: dict[str, m.Fact]) -> None:
    facts |= {
        "RIGHT-ARM.holding": fact("RIGHT-ARM.holding", "MACS-NEW"),
        "MACS-NEW.held_by": fact("MACS-NEW.held_by", "RIGHT-ARM"),
        "MACS-NEW.grasp": fact("MACS-NEW.grasp", GRASP),
    }
    scene = believed(cell, facts, {"RIGHT-ARM": sample("C-7.2")}, None)
    module = next(row for row in scene.objects if row.name == "MACS-NEW")
    arm = scene.arms[0]

    assert module.pose == pytest.approx(geometry.compose(HAND, GRASP).tolist())
    assert module.where == "RIGHT-ARM's hand"
    assert module.off_m is None
    assert (arm.tcp, arm.moving, arm.hand_width_m) == (HAND, "C-7.2", 0.02)
    assert in_words(scene) == ["RIGHT-ARM moves (C-7), holds MACS-NEW"]


def test_a_held_door_turns_about_its_hinge_whatever_the_attitude_of_the_hand() -> None:
    cell = Cell.load("servicing")
    door = cell.object("DOOR-2")
    shut = cell.object_pose(door.name)
    point = door.grasp_points[0].frame.pose[:3]
    opened = hinges.turned(shut, door.hinge.axis, math.radians(40.0))
    hand = [*geometry.transform_point(opened, point).tolist(), *shut[3:].tolist()]  # with its attitude at the shut door
    known = {change.key: fact(change.key, change.value) for change in initial_facts(cell)}
    known["DOOR-2.held_by"] = fact("DOOR-2.held_by", "LEFT-ARM")
    known["DOOR-2.grasp"] = fact("DOOR-2.grasp", [*(-n for n in point), 0.0, 0.0, 0.0, 1.0])
    arm = msgspec.structs.replace(sample("C-7.2"), tcp_pose=hand)
    scene = believed(cell, known, {"LEFT-ARM": arm}, None)
    pose = next(row.pose for row in scene.objects if row.name == "DOOR-2")
    assert pose == pytest.approx(opened.tolist(), abs=1e-9)


def test_a_difference_is_measured_printed_and_outlined(cell: Cell, facts: dict[str, m.Fact], tmp_path: Any) -> None:
    there = geometry.compose(
        geometry.translate(cell.object_pose("MACS-OLD"), (0.03, 0.0, 0.04)),
        geometry.from_rpy((0, 0, 0), (0, 0, math.radians(4.0))),
    ).tolist()
    facts["MACS-OLD.frame"] = fact("MACS-OLD.frame", facts["MACS-OLD.frame"].value, m.Validity.SUSPECT)
    scene = believed(cell, facts, {}, known := truth(cell, {"LEFT-ARM": ["MACS-OLD"]}, MACS_OLD=there))
    row = next(row for row in scene.objects if row.name == "MACS-OLD")

    assert row.off_m == pytest.approx(0.05)
    assert row.turned_rad == pytest.approx(math.radians(4.0))
    assert in_words(scene) == [
        "LEFT-ARM truly holds MACS-OLD",
        "MACS-OLD (suspect), 50.0 mm off, turned 4.0 deg",
    ]
    left, right = picture("swapout", scene, known, tmp_path / "a.png", "overview").panels
    assert left.doubtful == right.outlined == ["MACS-OLD"]
    assert left.scene.poses["MACS-OLD"] != right.scene.poses["MACS-OLD"] == there


def test_where_belief_is_right_it_says_so(cell: Cell, facts: dict[str, m.Fact]) -> None:
    scene = believed(cell, facts, {}, truth(cell, {}))

    assert not any(map(differs, scene.objects))
    assert in_words(scene) == ["nothing moves; every object is at its believed place"]
    assert scene.arms[0].tcp is None
    assert scene.scene.joints["RIGHT-ARM"] == cell.arm("RIGHT-ARM").home_rad


@pytest.mark.parametrize(
    ("rpy_deg", "shown"),
    [
        ((10, 20, -30), "10 20 -30"),
        ((0, 90, 0), "0 90 0"),
        ((-107.5, 89.95, -107.5), "0 90 0"),  # the same attitude but for 0.05 deg
        ((30, 90, 10), "20 90 0"),
        ((30, -90, 10), "40 -90 0"),
        ((0, 0, 180), "0 0 180"),
    ],
)
def test_attitudes_in_degrees(rpy_deg: tuple[float, ...], shown: str) -> None:
    assert degrees(geometry.from_rpy((0, 0, 0), [math.radians(n) for n in rpy_deg])) == shown


def test_positions_in_centimetres() -> None:
    assert centimetres((0.8, -0.0000001, 0.12345)) == "80 0 12.35"


def test_a_request_is_shown_by_the_camera_on_the_hand_else_by_the_one_that_looks_at_its_goal() -> None:
    here, there = {"xyz": (0.0, 0.0, 1.0), "looks_at": (0.0, 0.0, 0.0)}, {"xyz": (0.0, 0.0, 1.0), "looks_at": (1, 0, 1)}
    fixed = [Camera(name="CAM-A", **here), Camera(name="CAM-B", **there)]
    on_other = Camera(name="CAM-C", arm="LEFT-ARM", **here)
    on_hand = Camera(name="CAM-D", arm="RIGHT-ARM", **here)

    def shown(cameras: list[Camera], *goal: float) -> str:
        asked = m.TeleopState(request="move it", centre=list(goal))
        return request_camera(cameras, "RIGHT-ARM", msgspec.structs.replace(sample("C-7.2"), operation=asked))

    assert shown([*fixed, on_other], 0.02, 0.0, 0.3) == "CAM-A"
    assert shown([*fixed, on_other], 0.9, 0.1, 1.0) == "CAM-B"
    assert shown([*fixed, on_other]) == "CAM-B"  # without a goal: the hand
    assert shown([*fixed, on_hand], 0.9, 0.1, 1.0) == "CAM-D"
    assert shown([on_other], 0.0, 0.0, 0.3) == ""
