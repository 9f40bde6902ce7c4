"""What `rtc trace` and `rtc why` add to the words of a record: what it waits for now, and JSON."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.apps.cli.trace import as_json
from rtc.protocol import messages as m
from rtc.protocol.messages import NoteKind
from rtc.wording.commands import waits_for
from tests.wording.test_commands import failed_in_step_2, note


def held(kind: NoteKind, **facts: Any) -> m.CommandRecord:
    notes = [note(m.Phase.HELD, kind=kind, **facts)]
    return m.CommandRecord(
        command="C-8", text="X", source="operator", request="r", accepted_at_s=10.0, phase=m.Phase.HELD, notes=notes
    )


def test_a_held_command_shows_its_present_owner_the_line_before_it_and_what_clears_it() -> None:
    """The note names the owner when the waiting began; another one has the arm now."""
    status = {
        "resources": [
            {"name": "LEFT-ARM", "owner": "C-1", "owners": ["C-1"], "waiting": []},
            {"name": "RIGHT-ARM", "owner": "C-6", "owners": ["C-6"], "waiting": ["C-7", "C-8", "C-9"]},
        ],
        "commands": [
            {"command": name, "text": f"text of {name}", "phase": "executing", "step": "1 of 1: go"}
            for name in ("C-1", "C-6", "C-7", "C-8")
        ],
    }
    waits, clears = waits_for(msgspec.convert(status, m.Status), held(NoteKind.IN_USE, about="RIGHT-ARM", owner="C-5"))
    assert all(word in waits for word in ("RIGHT-ARM", "C-6", "executing", "text of C-6", "C-7"))
    assert "C-5" not in waits
    assert "C-1" not in waits
    assert all(word in clears for word in ("wait for C-6, C-7", "ABORT C-6", "ABORT C-8"))


def test_a_command_that_waits_for_another_shows_that() -> None:
    waits, clears = waits_for(m.Status(), held(NoteKind.AFTER, owner="C-5"))
    assert waits == "waits for C-5 to succeed"
    assert clears.endswith("ABORT C-8")


def test_a_closed_resource_has_no_owner_to_abort() -> None:
    closed = m.ResourceRow(name="RIGHT-ARM", quarantine="MCM", waiting=["C-8"])
    (waits,) = waits_for(m.Status(resources=[closed]), held(NoteKind.IN_USE, about="RIGHT-ARM", owner="MCM"))
    assert "rtc status" in waits


def test_json_has_times_since_acceptance_and_addresses() -> None:
    record_json = as_json(failed_in_step_2())
    assert record_json["notes"][4]["since_accept_s"] == 0.5
    assert record_json["notes"][4]["address"] == "10"
    assert record_json["outcome"]["kind"] == "failed"
