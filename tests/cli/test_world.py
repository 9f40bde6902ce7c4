"""Keys as people type them, values as people read them."""

from __future__ import annotations

from typing import Any

import pytest

from rtc.cli.world import shown, spelt, stated
from rtc.protocol import messages as m


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
        ("LEFT-ARM.hand_width", 0.08, "8 cm"),
        ("MACS-NEW.mass", 2.0, "2 kg"),
        ("MACS-NEW.seat", "RACK-1", "RACK-1"),
        ("BOLT.turns", 2.5, "2.5"),
    ],
)
def test_a_fact_is_stated_in_the_units_of_sentences(key: str, value: Any, text: str) -> None:
    fact = m.Fact(key=key, value=value, validity=m.Validity.VALID, version=1, source="cell", at_s=0.0)
    assert stated(fact) == text
