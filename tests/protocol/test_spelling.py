"""Spelling mistakes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtc.protocol.spelling import edit_distance, nearest_words

WORDS = ["GRASP", "MAINTAIN", "MOVE", "STOW", "SHOW", "LEFT-ARM", "RIGHT-ARM"]


@pytest.mark.parametrize(
    ("written", "meant", "count"),
    [
        ("", "", 0),
        ("GRASP", "GRASP", 0),
        ("GRAPS", "GRASP", 1),
        ("MANTAIN", "MAINTAIN", 1),
        ("MOOVE", "MOVE", 1),
        ("SLOW", "STOW", 1),
        ("", "STOW", 4),
        ("RIHGTARM", "RIGHT-ARM", 2),
    ],
)
def test_edit_distance(written: str, meant: str, count: int) -> None:
    assert edit_distance(written, meant) == count


@pytest.mark.parametrize(
    ("written", "near"),
    [
        ("GRAPS", ["GRASP"]),
        ("SLOW", ["SHOW", "STOW"]),
        ("LIGHT-ARM", ["RIGHT-ARM"]),
        ("UNPLUG", []),
        ("X", []),
        ("", []),
        ("M" * 1000, []),
    ],
)
def test_nearest_words(written: str, near: list[str]) -> None:
    assert nearest_words(written, WORDS) == near


@settings(derandomize=True)
@given(st.text("ABC-", max_size=8), st.text("ABC-", max_size=8))
def test_the_distance_is_the_same_both_ways_and_none_only_for_the_same_word(one: str, other: str) -> None:
    assert edit_distance(one, other) == edit_distance(other, one) <= max(len(one), len(other))
    assert (edit_distance(one, other) == 0) == (one == other)
