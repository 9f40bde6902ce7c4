"""An arm with a coupler: the hands that it can lock, and what a cell may not say of them."""

from __future__ import annotations

import re

import msgspec
import pytest

from rtc.model.cells import model_checks
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Arm
from rtc.world.model import World, initial_facts
from tests.plugins.tool_changer.cells import FIGURES, with_hands

ARM, HAND = "RIGHT-ARM", "HAND-B"
CELL = with_hands()


def changed(**fields: object) -> list[Arm]:
    """The arms of the cell, the first with another first hand."""
    arm = CELL.arms[0]
    hands = [msgspec.structs.replace(arm.hands[0], **fields), *arm.hands[1:]]
    return [msgspec.structs.replace(arm, hands=hands), *CELL.arms[1:]]


def test_the_arm_with_a_hand_has_its_figures_and_the_joints_of_the_arm() -> None:
    arm = CELL.with_hands({ARM: HAND}).arm(ARM)

    assert (arm.gripper.max_opening_m, arm.gripper.max_force_n, arm.payload_kg) == FIGURES[HAND][4:]
    assert (arm.joints, arm.home_deg, arm.base) == (CELL.arm(ARM).joints, CELL.arm(ARM).home_deg, CELL.arm(ARM).base)


def test_a_cell_with_hands_is_one_document() -> None:
    assert Cell.from_bytes(CELL.encode()) == CELL


@pytest.mark.parametrize(
    ("fields", "place"),
    [
        ({"name": "HAND-C"}, "arms[0].hands[0].name"),
        ({"name": "SATELLITE"}, "arms[0].hands[0].name"),
        ({"coupling": "HANDLE"}, "arms[0].hands[0].coupling"),
    ],
)
def test_a_hand_that_is_no_object_to_take_is_named_with_its_place(fields: dict[str, str], place: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"$.{place}: ")):
        msgspec.structs.replace(CELL, arms=changed(**fields))


def test_a_hand_whose_model_lacks_a_link_is_named_with_its_place() -> None:
    places = [place for place, _ in model_checks.problems(changed(tcp_link="nothing"), CELL.texts)]

    assert places == ["arms[0].hands[0].tcp_link"]


def test_a_camera_needs_a_hand_that_stays() -> None:
    camera = msgspec.structs.replace(CELL.cameras[0], arm=ARM)

    with pytest.raises(ValueError, match=re.escape("$.cameras[0].arm: ")):
        msgspec.structs.replace(CELL, cameras=[camera, *CELL.cameras[1:]])


def test_a_hand_whose_model_moves_a_joint_is_refused() -> None:
    texts = dict(CELL.texts)
    texts["HAND-A.urdf"] = texts["HAND-A.urdf"].replace('<origin xyz="0.4318 0 0" rpy', '<origin xyz="0.44 0 0" rpy')

    assert [place for place, _ in model_checks.problems(CELL.arms, texts)] == ["arms[0].hands[0].urdf"]


def test_only_an_arm_with_a_coupler_has_the_fact_of_its_hand() -> None:
    world = World().overlay(initial_facts(CELL))

    assert world.value("RIGHT-ARM.hand") == ""
    assert world.get("LEFT-ARM.hand") is None
