"""Keys as people type them, values as people read them."""

from __future__ import annotations

from typing import Any

import pytest

from rtc.cli.world import shown, spelt


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
