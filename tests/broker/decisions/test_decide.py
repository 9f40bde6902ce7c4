"""Clients and listeners: requests that are repeated, clients that go away, notes that are published."""

from __future__ import annotations

from broker.decisions.command import termination
from broker.decisions.effects import PublishNote, ReportEnd
from broker.decisions.events import (
    BrokerRestarted,
    ClientGone,
    ListenersChanged,
)
from rtc.protocol.outcomes import RefusalReason
from tests.broker.harness import Harness

# --- clients ------------------------------------------------------------------------------------------


def test_a_repeated_sentence_is_one_command():
    s = Harness()
    s.says("X", request="r1")
    assert s.says("X", request="r1") == ["tell ann Accepted C-1"]
    assert s.says("X", client="bob", request="r1")[0] == "tell bob Accepted C-2"


def test_the_rest_of_a_halt_that_its_caller_named_like_a_command_is_not_the_rest_of_that_command():
    s = Harness()
    s.executing()
    s.halts("C-1", halt="h1")
    s.rests("C-1")
    assert s.phase("C-1") == "halting"
    s.rests("stop-C-1")
    assert s.phase("C-1") == "closing"


def test_a_result_is_kept_for_a_client_that_asks_again():
    s = Harness()
    s.says("X", request="r1")
    s.declines("C-1")
    assert s.says("X", request="r1") == ["tell ann Accepted C-1", "tell ann CommandEnded"]


def test_a_client_that_goes_away_halts_only_what_it_wanted_halted():
    s = Harness()
    s.says("X")
    s.says("X", halt_if_lost=True)
    s.handle(ClientGone, client="ann")
    assert [s.phase(c) for c in ("C-1", "C-2")] == ["parsing", "gone"]


# --- what exploring all interleavings found (tests/simulation) ----------------------------------------


def test_the_request_of_a_long_command_outlives_thousands_of_short_ones(monkeypatch):
    monkeypatch.setattr(termination, "ENDED_KEPT", 5)
    monkeypatch.setattr(termination, "FORGOTTEN_AT_ONCE", 1)
    s = Harness()
    s.says("X", request="long")
    for n in range(20):
        s.says("X", request=f"short-{n}")
        s.declines(f"C-{s.state.accepted}")
    assert s.says("X", request="long") == ["tell ann Accepted C-1"]
    assert len(s.state.requests) <= 5 + len(s.state.commands)


def test_notes_are_sent_to_the_client_that_wants_them_and_to_listeners_and_kept_in_any_case():
    s = Harness()
    assert "note C-1 parsing" in s.says("X")
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []
    assert s.handle(ListenersChanged, listening=True) == []
    assert "note C-3 parsing" in s.says("X", progress=False)
    s.handle(ListenersChanged, listening=False)
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []
    assert all(len(command.notes) == 1 for command in s.state.commands.values())
    assert [e.client for e in s.log if isinstance(e, PublishNote)] == ["ann", ""]


def test_a_command_accepted_while_the_stream_is_crowded_publishes_its_end_alone():
    s = Harness()
    s.handle(ListenersChanged, listening=True)
    s.says("X", progress=False)
    s.handle(ListenersChanged, listening=True, crowded=True)
    s.says("Y", progress=False)
    assert "note C-3 parsing" in s.says("Z")  # its client wants them
    s.handle(ListenersChanged, listening=True)
    s.log.clear()
    for command in ("C-1", "C-2"):
        s.declines(command, RefusalReason.NAME)
    assert {e.note.command for e in s.log if isinstance(e, PublishNote)} == {"C-1"}
    ends = [e for e in s.log if isinstance(e, ReportEnd)]
    assert [e.ended.command for e in ends] == ["C-1", "C-2"]
    assert len(ends[1].record.notes) > 1
    assert s.state.counts["unwatched"] == 2


def test_a_restarted_broker_has_no_listeners_until_they_come_back():
    s = Harness()
    s.handle(ListenersChanged, listening=True)
    s.handle(BrokerRestarted)
    assert [line for line in s.says("X", progress=False) if line.startswith("note")] == []
