"""The table of the executor's states."""

from __future__ import annotations

import pytest

from rtc.protocol.outcomes import Reflex
from rtc.subsystems.motion.modes import AFTER_STOP, TRANSITIONS, Mode, Trigger


def test_every_state_has_its_row_and_obeys_a_halt() -> None:
    assert set(TRANSITIONS) == set(Mode)
    assert all(Trigger.HALTED in row for row in TRANSITIONS.values())
    assert all(row[Trigger.HALTED] in (Mode.STOPPING, state) for state, row in TRANSITIONS.items())


def test_every_reflex_leads_somewhere() -> None:
    assert set(AFTER_STOP) == set(Reflex)


def test_from_every_state_the_arm_comes_to_hold_again() -> None:
    def following(state: Mode) -> set[Mode]:
        row = TRANSITIONS[state]
        return set(row.values()) | (set(AFTER_STOP.values()) if state is Mode.STOPPING else set())

    for start in Mode:
        reached, fresh = {start}, {start}
        while fresh := {after for state in fresh for after in following(state)} - reached:
            reached |= fresh
        assert Mode.HOLDING in reached


def test_an_impossible_event_is_a_bug_that_names_itself(rig) -> None:
    with pytest.raises(AssertionError, match="RIGHT-ARM: tripped cannot happen while holding"):
        rig.executor._apply(Trigger.TRIPPED)
