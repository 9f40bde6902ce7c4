"""What the opening of a hand says about how its object is turned between the pads."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.messages import WorldChange
from rtc.spatial import geometry
from rtc.world.model import World, initial_facts
from workers.planning import pose_spread
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.tasks import flat_grip

SERVICING = CellModel(Cell.load("servicing"))
DRIVER, ARM, WIDTH_M, PAD_M = "POWER-DRIVER", "RIGHT-ARM", 0.030, 0.020
TOUCHING, ROUND = [[0.0, 0.0, 0.0], [0.0, 0.0, math.pi]], ["as planned", "turned by half a turn"]
SEEN_RAD = math.radians(1.6)
TWISTED_RAD = math.radians(-3.2)  # about the approach, by a bolt of 3.4 N.m: the pads were 1.5 mm farther apart


def held(hand: list[float], seat: str = "") -> WorldQuery:
    """The driver is in the hand, which is turned by `hand` (roll pitch yaw, rad) from its grasp point."""
    grasp = in_hand(geometry.from_rpy([0.0, 0.0, 0.0], hand))
    facts = {f"{DRIVER}.grasp": grasp.tolist(), f"{DRIVER}.held_by": ARM, f"{ARM}.holding": DRIVER}
    changes = [WorldChange(key=key, value=value) for key, value in {**facts, f"{DRIVER}.seat": seat}.items()]
    return WorldQuery(SERVICING, World(initial_facts(SERVICING.cell)).overlay(changes))


def bar() -> np.ndarray:
    return SERVICING.cell.object(DRIVER).grasp_point("TOOL-GRIP").frame.pose


def in_hand(bar_in_hand: np.ndarray) -> np.ndarray:
    return geometry.normalise(geometry.compose(bar_in_hand, geometry.inverse(bar())))


def bounds(found: tuple[np.ndarray, list[float]], hand: list[float]) -> list[tuple[float, float]]:
    """(least, most) angle (rad) about the axes of the grasp point."""
    offset = geometry.relative(geometry.from_rpy([0.0, 0.0, 0.0], hand), geometry.compose(found[0], bar()))
    half_widths = pose_spread.spread_at(found[1], bar())[3:]
    return [(a - b, a + b) for a, b in zip(geometry.to_rpy(offset).tolist(), half_widths, strict=True)]


def lies(hand: list[float], angles: list[float], opening_m: float, seat: str = "") -> list[tuple[float, float]]:
    """What is believed of a driver that was seen turned by `angles` in the hand."""
    seen = geometry.compose(geometry.from_rpy([0.0, 0.0, 0.0], hand), geometry.from_rpy([0.0, 0.0, 0.0], angles))
    spread = [0.002] * 3 + [SEEN_RAD] * 3
    found = flat_grip.between_pads(held(hand, seat), DRIVER, in_hand(seen), spread, opening_m, PAD_M)
    return bounds(found, hand)


@pytest.mark.parametrize("hand", TOUCHING, ids=ROUND)
@pytest.mark.parametrize("about", [0, 2])
def test_a_bar_that_was_seen_turned_may_have_turned_flat(hand: list[float], about: int) -> None:
    angles = [0.0, 0.0, 0.0]
    angles[about] = TWISTED_RAD
    least, most = lies(hand, angles, WIDTH_M + 0.0015)[about]
    assert least <= TWISTED_RAD + 1e-9
    assert most >= -1e-9
    assert 0.5 * (most - least) < abs(TWISTED_RAD)  # the middle is nearer to both than either is to the other


def test_pads_that_are_as_near_as_on_a_flat_bar_have_turned_it_flat() -> None:
    for least, most in (lies([0.0] * 3, [0.02, 0.0, TWISTED_RAD], WIDTH_M)[n] for n in (0, 2)):
        assert -0.015 < least <= 0.0 <= most < 0.015


def test_the_opening_says_nothing_about_the_closing_direction() -> None:
    least, most = lies([0.0] * 3, [0.0, 0.05, 0.0], WIDTH_M)[1]
    assert (least, most) == pytest.approx((0.05 - SEEN_RAD, 0.05 + SEEN_RAD), abs=1e-4)


def test_what_a_seat_holds_too_stays_as_it_is() -> None:
    least, most = lies([0.0] * 3, [0.0, 0.0, TWISTED_RAD], WIDTH_M, seat="TOOL-RACK")[2]
    assert (least, most) == pytest.approx((TWISTED_RAD - SEEN_RAD, TWISTED_RAD + SEEN_RAD), abs=1e-4)


def test_to_say_it_again_changes_nothing() -> None:
    query, seen = held([0.0] * 3), in_hand(geometry.from_rpy([0.0, 0.0, 0.0], [0.01, 0.0, TWISTED_RAD]))
    once = flat_grip.between_pads(query, DRIVER, seen, [0.002] * 3 + [SEEN_RAD] * 3, WIDTH_M + 0.0015, PAD_M)
    again = flat_grip.between_pads(query, DRIVER, *once, WIDTH_M + 0.0015, PAD_M)
    assert again[0] == pytest.approx(once[0], abs=1e-4)
    assert again[1] == pytest.approx(once[1], abs=1e-3)
