"""Names of primitives: of a command, of a life of the journal."""

from __future__ import annotations

import pytest

from rtc.protocol.primitive_id import belongs_to, command_of, number_of, primitive_id
from rtc.subsystems.base.subsystem import in_scope


def test_a_name_tells_its_command_and_its_life():
    name = primitive_id("C-3", 1, "k7f2")
    assert name == "C-3.1@k7f2"
    assert command_of(name) == "C-3"
    assert number_of(name) == 3
    assert belongs_to(name, "C-3", 1, "k7f2")


@pytest.mark.parametrize(
    "other",
    [("C-3", 2, "k7f2"), ("C-30", 1, "k7f2"), ("C-3", 1, "0000"), ("C-3", 1, "")],
    ids=["another step", "another command", "another life", "no life"],
)
def test_another_name_does_not_belong(other):
    assert not belongs_to("C-3.1@k7f2", *other)


@pytest.mark.parametrize("name", ["", "X-9.1", "C-.1", "C-3", "C-3.1@", "C-3.1@k7f2@k7f2"])
def test_what_is_no_name_has_no_number(name):
    assert number_of(name) == 0


def test_a_halt_of_a_command_reaches_its_primitives_of_any_life():
    assert in_scope("C-3", "LEFT-ARM", "C-3.1@k7f2")
    assert not in_scope("C-3", "LEFT-ARM", "C-30.1@k7f2")
