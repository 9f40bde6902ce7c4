"""Halts of commands, arms and everything: what stops, what ends, and what is answered."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions.effects import PublishHalt, SendHalt
from broker.decisions.events import (
    HaltCalled,
    HaltConfirmed,
    ListenersChanged,
    SubsystemConnected,
)
from rtc.protocol import wire
from rtc.protocol.advice import by_sentence
from rtc.protocol.messages import AnalyzerInput
from rtc.protocol.outcomes import OutcomeKind, StopReason
from tests.broker.harness import Harness, give_up, go_on, record, script, stated


@pytest.mark.parametrize("reach", ["says", "parsed", "elaborated"])
def test_halt_of_a_command_that_moves_nothing_ends_it_at_once(reach):
    s = Harness()
    getattr(s, reach)(*["X"] if reach == "says" else [])
    job = s.state.commands["C-1"].job.id
    assert s.halts() == ["halt ALL to MCM", f"cancel {job}", "note C-1 ended", "end C-1 halted"]
    assert s.answers("C-1", record(), job=job) == []  # the answer under way is stale


def test_halt_of_a_motion_waits_for_rest_and_puts_the_world_right():
    s = Harness()
    s.executing()
    assert s.halts() == ["halt ALL to MCM", "halt C-1 to MCM", "timer C-1", "note C-1 halting"]
    assert s.reports("C-1", StopReason.HALT) == [
        "no timer C-1",
        "ack C-1.1",
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]
    assert s.state.resources.held == {}


def test_halt_at_the_subsystem_itself_is_understood():
    s = Harness()
    s.executing()
    s.reports("C-1", StopReason.HALT)  # a halt by the emergency stop, past the broker
    assert s.phase("C-1") == "closing"
    assert s.answers("C-1", go_on())[-1] == "end C-1 halted"


@pytest.mark.parametrize("at_subsystem", [True, False])
def test_a_halted_arm_gets_advice_how_to_leave_and_says_what_still_moves(at_subsystem):
    s = Harness()
    s.executing()
    if not at_subsystem:
        s.halts()
    s.reports("C-1", StopReason.HALT)
    back = by_sentence("MOVE RIGHT-ARM BY -5 CM ALONG Z")
    swings = "X may swing for 0.2 s more"
    s.answers("C-1", msgspec.structs.replace(give_up(StopReason.HALT), clears=back, remark=swings))
    assert s.outcome("C-1").kind is OutcomeKind.HALTED
    assert s.outcome("C-1").message.endswith(f"; {swings}")  # wording: the remark of the analyzer
    assert s.outcome("C-1").refusal.clears == back


def test_an_analysis_under_way_is_let_finish_and_its_advice_ignored():
    s = Harness()
    s.analyzing(script(steps=2))
    assert s.halts() == ["halt ALL to MCM", "timer C-1", "note C-1 closing"]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]


def test_stated_facts_are_written_although_the_command_is_halted():
    s = Harness()
    s.elaborated(script(steps=2, resources=("MODULE",)))
    s.answers("C-1", stated())
    assert s.halts() == ["halt ALL to MCM", "timer C-1", "note C-1 closing"]
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halted"]


def test_rest_without_confirmation_is_distinguished_and_closes_the_arm():
    s = Harness()
    s.executing()
    s.halts()
    assert s.rings("C-1") == [
        "no timer C-1",
        "job C-1/4 analyzer #1 lease RIGHT-ARM",
        "timer C-1",
        "note C-1 closing",
    ]
    stated = wire.decoder(AnalyzerInput)(s.state.commands["C-1"].job.input)
    assert (stated.report.joints, stated.closing) == ([], True)  # the position is unknown, and the world records that
    assert s.answers("C-1", go_on()) == ["no timer C-1", "note C-1 ended", "end C-1 halt_not_confirmed"]
    assert s.state.resources.quarantine == {"RIGHT-ARM": ("MCM", "C-1.1")}
    s.parsed()
    assert s.phase("C-2") == "held"
    assert s.rests("h1") == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


def test_halt_all_starts_nothing_that_was_in_line():
    s = Harness()
    s.executing()
    s.parsed()
    s.parsed()
    effects = s.halts()
    assert [e for e in effects if e.startswith(("job", "primitive"))] == []
    assert [s.phase(c) for c in ("C-1", "C-2", "C-3")] == ["halting", "gone", "gone"]
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    s.executing()
    assert s.phase("C-4") == "executing"  # and a new one works at once


def test_a_sentence_sent_before_halt_all_does_not_start_after_it():
    s = Harness()
    s.now = 10.0
    s.halts()
    assert s.says("X", sent_at_s=9.0) == ["tell ann Accepted C-1", "note C-1 ended", "end C-1 halted"]
    assert s.says("X", sent_at_s=10.5)[1] == "job C-2/1 parser #1"


@pytest.mark.parametrize(
    ("received_at_s", "sent_at_s", "halted"),
    [
        (10.0, 10.5, False),  # sent after the halt had been obeyed
        (10.0, 9.5, True),
        (10.0, 0.0, True),  # when it was sent is unknown
        (10.0, 99.0, True),  # a clock in the future proves nothing
        (0.0, 10.5, True),  # when it was received is unknown
    ],
)
def test_a_halt_that_a_subsystem_forwards_late_spares_what_was_sent_later(received_at_s, sent_at_s, halted):
    s = Harness()
    s.now = 11.0
    s.says("X", sent_at_s=sent_at_s)
    s.now = 12.0
    s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL", called_at_s=9.0, received_at_s=received_at_s)
    assert s.phase("C-1") == ("gone" if halted else "parsing")


def test_halt_of_one_arm_leaves_the_other():
    s = Harness()
    s.executing()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    assert s.halts("LEFT-ARM") == ["halt LEFT-ARM to MCM", "halt C-2 to MCM", "timer C-2", "note C-2 halting"]
    assert s.phase("C-1") == "executing"


def test_halt_of_an_ended_command_is_no_mistake():
    s = Harness()
    s.says("X")
    s.declines("C-1")
    assert s.halts("C-1") == []  # the MCM confirms that nothing of it moves
    assert s.halts("C-2", "h2") == ["decline halt h2"]
    assert s.says("HALT C-1")[-1] == "end C-2 succeeded"


def test_halt_of_nothing_known_is_declined():
    assert Harness().halts("C-9") == ["decline halt h1"]


def test_halt_on_an_idle_system_still_reaches_the_subsystem():
    assert Harness().halts() == ["halt ALL to MCM"]


@pytest.mark.parametrize("caller", ["ann", "bob", "MCM"])
def test_a_halt_whose_name_was_used_before_stops_what_is_in_scope_now(caller):
    """Two callers may count their halts from one; a button may always say the same."""
    s = Harness()
    s.halts("LEFT-ARM", "1")
    s.executing()
    assert s.handle(HaltCalled, client=caller, halt="1", scope="ALL")[:2] == ["halt ALL to MCM", "halt C-1 to MCM"]
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", go_on())
    s.executing()
    assert s.handle(HaltCalled, client=caller, halt="1", scope="ALL")[:2] == ["halt ALL to MCM", "halt C-2 to MCM"]


def test_a_halt_by_both_endpoints_is_counted_once_and_a_new_command_works():
    s = Harness()
    s.halts()
    s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL")
    assert s.state.counts["halts"] == 1
    assert s.phase(s.executing()) == "executing"


def test_a_halt_is_published_once_to_listeners_also_one_that_halts_nothing():
    s = Harness()
    assert not any(line.startswith("publish") for line in s.halts("ALL", "h0"))
    s.handle(ListenersChanged, listening=True)
    assert "publish halt h1 ALL" in s.handle(HaltCalled, client="ann", halt="h1", scope="ALL", called_at_s=9.0)
    assert not any(
        line.startswith("publish")
        for line in s.handle(HaltCalled, client="MCM", halt="h1", scope="ALL", called_at_s=9.0)
    )
    s.handle(HaltCalled, client="ann", halt="h2", scope="NO-ARM")
    published = [e.halt for e in s.log if isinstance(e, PublishHalt)]
    assert [(halt.halt, "NO-ARM" in halt.refused) for halt in published] == [("h1", False), ("h2", True)]


def test_a_halt_is_answered_under_the_number_it_came_with():
    s = Harness()
    s.handle(HaltCalled, client="ann", halt="1", scope="ALL", call="7-1")
    s.handle(HaltCalled, client="MCM", halt="1", scope="ALL", call="4-9")
    assert [e.order.call for e in s.log if isinstance(e, SendHalt)] == ["7-1", "4-9"]


def test_halt_typed_as_a_sentence_ends_when_rest_is_confirmed():
    s = Harness()
    s.executing()
    assert s.says("halt all.") == [
        "tell ann Accepted C-2",
        "note C-2 halting",
        "timer C-2",
        "halt ALL to MCM",
        "halt C-1 to MCM",
        "timer C-1",
        "note C-1 halting",
    ]
    assert s.rests("C-2") == ["no timer C-2", "note C-2 ended", "end C-2 succeeded"]


def test_halt_typed_and_not_confirmed():
    s = Harness()
    s.says("HALT")
    assert s.rests("C-1", at_rest=False)[-1] == "end C-1 halt_not_confirmed"


def test_halt_typed_ends_when_all_that_got_it_have_confirmed():
    s = Harness()
    s.handle(SubsystemConnected, subsystem="CAM", pid=2, performers=["CAMERA"])
    s.executing()
    s.says("HALT ALL")
    cam = {"subsystem": "CAM", "halt": "C-2", "at_rest": True}
    assert s.handle(HaltConfirmed, **cam) == []  # C-1 still moves
    assert s.handle(HaltConfirmed, **cam) == []
    assert (s.phase("C-1"), s.phase("C-2")) == ("halting", "halting")
    assert s.rests("C-2")[-1] == "end C-2 succeeded"


def test_halt_typed_names_who_has_not_confirmed():
    s = Harness()
    s.handle(SubsystemConnected, subsystem="CAM", pid=2, performers=["CAMERA"])
    s.says("HALT ALL")
    s.handle(HaltConfirmed, subsystem="CAM", halt="C-1", at_rest=True)
    assert s.rings("C-1")[-1] == "end C-1 halt_not_confirmed"
    assert "MCM" in s.outcome("C-1").message  # wording: who has not


def test_halt_of_an_arm_stops_what_names_it_alone_or_with_the_other_and_nothing_else():
    s = Harness()
    s.elaborated()
    s.parsed(hand="LEFT-ARM", after="C-1")
    s.parsed(hand="BOTH-ARMS")
    s.parsed(hand="RIGHT-ARM", to_hand="LEFT-ARM")
    s.parsed(hand="RIGHT-ARM")
    s.halts("LEFT-ARM")
    assert list(s.state.commands) == ["C-1", "C-5"]


def test_halt_of_an_object_names_its_commands_to_the_subsystem_that_knows_no_objects():
    """The MCM got the name of the object, confirmed rest of nothing, and the answer was that nothing had halted."""
    s = Harness()
    s.executing(object="MODULE")
    s.parsed(object="MODULE")  # waits for the arm
    assert s.halts("MODULE")[:2] == ["halt C-1 to MCM", "halt C-1 to MCM"]  # that of the caller, and of the command
    assert next(e.order.halt for e in s.log if isinstance(e, SendHalt)) == "h1"
    assert (s.phase("C-1"), s.phase("C-2")) == ("halting", "gone")


def test_halt_of_an_object_of_which_nothing_moves_is_answered():
    s = Harness()
    s.parsed(object="MODULE")
    assert s.halts("MODULE")[0] == "halt C-1 to MCM"
    assert s.phase("C-1") == "gone"


def test_halt_typed_of_an_object_ends_when_its_motion_rests():
    s = Harness()
    s.executing(object="MODULE")
    s.says("HALT MODULE")
    s.answers("C-2", record(verb="HALT", kind="control", object="MODULE"))
    assert (s.phase("C-1"), s.phase("C-2")) == ("halting", "halting")
    assert [e.order.scope for e in s.log if isinstance(e, SendHalt)] == ["C-1", "C-1"]


@pytest.mark.parametrize("as_sentence", [True, False])
@pytest.mark.parametrize("moves", [True, False])
def test_after_a_halt_of_one_command_none_that_waits_for_it_begins(as_sentence, moves):
    """It began at once: the arm that had been halted moved on by itself."""
    s = Harness()
    s.executing() if moves else s.elaborated()
    s.elaborated(script(resources=("RIGHT-ARM", "LEFT-ARM")), hand="LEFT-ARM")
    s.parsed(hand="LEFT-ARM")  # behind C-2
    s.elaborated(script(resources=("CAMERA",)), hand="")
    planned = s.parsed(hand="")
    s.says("HALT C-1") if as_sentence else s.halts("C-1")
    assert [s.phase(c) for c in ("C-1", "C-2", "C-3")] == ["halting" if moves else "gone", "gone", "gone"]
    assert s.phase("C-4") != "gone"
    s.answers(planned, script())  # it was given before, and its plan comes later
    assert s.phase(planned) == "gone"
    if moves:
        s.reports("C-1", StopReason.HALT)
        s.answers("C-1", go_on())
    assert s.phase(s.executing()) == "executing"


def test_halt_typed_of_a_name_that_nothing_has_halts_everything():
    s = Harness()
    s.executing()
    s.says("HALT RIHGT-ARM")
    s.answers("C-2", record(verb="HALT", kind="control", object="RIHGT-ARM"))
    assert s.phase("C-1") == "halting"
    s.rests("C-2")
    assert s.outcome("C-2").kind is OutcomeKind.SUCCEEDED
    assert "ALL" in s.outcome("C-2").message  # wording: what was halted
    assert "RIHGT-ARM" in s.outcome("C-2").message  # wording: and why
