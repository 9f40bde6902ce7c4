"""Keys as people type them, values as people read them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.apps.cli.world import spelt, with_motions
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.wording.facts import shown, stated, units_in

UNITS = {"LEFT-ARM": ("deg", "deg"), "RIGHT-ARM": ("deg", "deg"), "GANTRY": ("mm", "deg")}


@pytest.mark.parametrize(
    ("typed", "key"), [("macs_new.frame", "MACS-NEW.frame"), ("RIGHT-ARM", "RIGHT-ARM"), ("bay-2.SEAT", "BAY-2.seat")]
)
def test_a_key_is_spelt_as_the_database_does(typed: str, key: str) -> None:
    assert spelt(typed) == key


@pytest.mark.parametrize(
    ("value", "text"), [([0.123456, 1.0], "[0.1235 1]"), (None, "-"), ("", "-"), ("RACK-1", "RACK-1"), (-0.00001, "0")]
)
def test_a_value_is_readable(value: Any, text: str) -> None:
    assert shown(value) == text


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("MACS-NEW.frame", [0.8, -0.8, 0.605, 0.0, 0.0, 1.0, 0.0], "80 -80 60.5 cm, 0 0 180 deg"),
        ("MACS-NEW.grasp", None, "-"),
        ("LEFT-ARM.joints", [1.5707963, 0.0], "90 0 deg"),
        ("GANTRY.joints", [-0.05, 1.5707963], "-50 mm, 90 deg"),
        ("OVER.posture_of_gantry", [0.5, 0.0], "500 mm, 0 deg"),
        ("STRANGE.joints", [0.5, 0.0], "[0.5 0] (rad, or m of a joint that slides)"),
        ("GANTRY.joints", None, "-"),
        ("LEFT-ARM.hand_width", 0.08, "8 cm"),
        ("MACS-NEW.mass", 2.0, "2 kg"),
        ("MACS-NEW.seat", "RACK-1", "RACK-1"),
        ("BOLT.turns", 2.5, "2.5"),
    ],
)
def test_a_fact_is_stated_in_the_units_of_sentences(key: str, value: Any, text: str) -> None:
    fact = m.Fact(key=key, value=value, validity=m.Validity.VALID, version=1, source="cell", at_s=0.0)
    assert stated(fact, UNITS) == text


def test_the_units_of_joints_are_those_of_the_cell() -> None:
    units = units_in(Cell.load("gantry"))
    assert units["GANTRY"] == ("mm", "mm", *("deg",) * 6)


def test_the_goal_of_a_slide_is_stated_in_millimetres() -> None:
    path = {"time_s": [0.0, 4.0], "positions": [[0.0, 0.0], [0.25, 0.0]]}
    value = {"primitive": "C-2.1@x", "started_ago_s": 1.5, **path}
    fact = m.Fact(key="GANTRY.motion", value=value, validity=m.Validity.CHANGING, version=1, source="C-2", at_s=0.0)
    assert stated(fact, UNITS) == "to 250 mm, 0 deg in 4.0 s, started 1.5 s ago (C-2.1@x)"


def test_a_moving_arm_has_its_path_and_the_time_of_its_start() -> None:
    fact = m.Fact(
        key="RIGHT-ARM.joints", value=[0.0, 0.0], validity=m.Validity.CHANGING, version=3, source="C-1/5", at_s=1.0
    )
    still = [[0.0, 0.0], [0.0, 0.0]]
    path = {"time_s": [0.0, 4.0], "positions": [[0.0, 0.0], [1.5707963, 0.0]]}
    path |= {"velocities": still, "accelerations": still}
    motion = m.MotionRow(arm="RIGHT-ARM", command="C-2", primitive="C-2.1@x", started_ago_s=1.5, **path)
    elsewhere = msgspec.structs.replace(motion, arm="LEFT-ARM")

    joints, found = with_motions([fact], [motion, elsewhere], 10.0)

    assert joints is fact
    assert (found.key, found.validity, found.at_s) == ("RIGHT-ARM.motion", m.Validity.CHANGING, 8.5)
    assert found.value["positions"] == path["positions"]
    assert stated(found, UNITS) == "to 90 0 deg in 4.0 s, started 1.5 s ago (C-2.1@x)"
    assert with_motions([fact], [], 10.0) == [fact]
