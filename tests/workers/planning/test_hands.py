"""Which hand an arm has is a fact: it decides with which model workers plan."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.protocol.messages import Limits, Validity, WorldChange
from rtc.world.model import World, initial_facts
from tests.plugins.tool_changer.cells import FIGURES, OUT_M, with_hands
from tests.workers.conftest import MODEL
from workers.mechanisms.facts import assess
from workers.planning import scenes
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

ARM, HAND = "RIGHT-ARM", "HAND-B"
CELL = with_hands()
WHOLE = CellModel(CELL)
WORLD = World().overlay(initial_facts(CELL))


def query(hand: str, validity: Validity = Validity.VALID) -> WorldQuery:
    return WorldQuery(WHOLE, WORLD.overlay([WorldChange(key=f"{ARM}.hand", value=hand, validity=validity)]))


def test_the_tcp_and_the_figures_of_the_hand_follow_from_the_fact() -> None:
    without, fitted = query(""), query(HAND)

    further = fitted.tcp(ARM)[:3] - without.tcp(ARM)[:3]
    assert np.isclose(np.linalg.norm(further), FIGURES[HAND][2] - OUT_M)
    assert fitted.cell.arm(ARM).gripper.max_opening_m == FIGURES[HAND][4]
    assert without.cell.arm(ARM).gripper.max_opening_m == CELL.arm(ARM).gripper.max_opening_m


def test_a_doubtful_hand_is_planned_with_and_named_in_the_primitive() -> None:
    assert query(HAND, Validity.SUSPECT).hand_planned_with(ARM) == HAND
    assert query("").hand_planned_with(ARM) == ""
    assert query("").hand_planned_with("LEFT-ARM") is None


def test_the_models_of_each_set_of_hands_are_built_once() -> None:
    assert query(HAND).model is query(HAND).model
    assert query("").model is WHOLE
    assert query(HAND).after([WorldChange(key=f"{ARM}.hand", value="")]).model is WHOLE


def test_a_cell_without_couplers_has_one_model() -> None:
    world = World().overlay([*initial_facts(MODEL.cell), WorldChange(key=f"{ARM}.hand", value=HAND)])

    assert WorldQuery(MODEL, world).model is MODEL


def test_the_hand_in_the_coupler_is_no_obstacle_in_its_rack() -> None:
    near = CELL.object_pose(HAND)
    joints = query("").model.arms[ARM].ik(near.tolist(), near=CELL.arm(ARM).home_rad)[0]

    def hits(hand: str) -> set[str]:
        asked = query(hand).after([WorldChange(key=f"{ARM}.joints", value=joints.tolist())])
        scene = msgspec.structs.replace(scenes.scene_of(asked, ARM, Limits()), clearance_m=0.0)
        every = {arm.name: asked.joints(arm.name) for arm in asked.cell.arms}
        return {hit.body_b.split()[0] for hit in asked.model.collision.too_near(every, scene)}

    assert HAND in hits("")
    assert HAND not in hits(HAND)


@pytest.mark.parametrize(("validity", "refused"), [(Validity.VALID, True), (Validity.SUSPECT, False)])
def test_a_hand_in_a_coupler_lies_nowhere_else(validity: Validity, refused: bool) -> None:
    stated = [WorldChange(key=f"{HAND}.seat", value=f"{HAND}-RACK")]
    before = query(HAND, validity)

    found = [key for key, _ in assess.hands(stated, before, before.after(stated), {})]

    assert found == ([f"{HAND}.seat"] if refused else [])
