"""The sentences of one client are taken up in the order given; control does not wait."""

from __future__ import annotations

import pytest

from broker.decisions.events import (
    BrokerRestarted,
)
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind
from tests.broker.harness import Harness, go_on, record, script


def test_what_one_client_gives_is_taken_up_in_the_order_given():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    assert s.answers("C-2", record()) == []  # the parser was quicker with it
    assert s.phase("C-2") == "parsing"
    assert s.answers("C-1", record()) == ["job C-1/2 elaborator #1", "note C-1 elaborating", "note C-2 held"]
    assert s.state.intake_order == {}


def test_the_commands_of_others_do_not_wait():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND", client="bob")
    assert s.answers("C-2", record()) == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


@pytest.mark.parametrize("end", [Harness.declines, lambda s, command: s.halts(command)], ids=["refused", "halted"])
def test_a_sentence_that_ends_unread_lets_the_next_one_go(end):
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    assert end(s, "C-1")[-2:] == ["job C-2/2 elaborator #1", "note C-2 elaborating"]


def test_who_waits_behind_one_that_ends_still_waits_for_the_one_before_that():
    s = Harness()
    for text in ("FIRST", "SECOND", "THIRD"):
        s.says(text)
    s.answers("C-3", record(hand="LEFT-ARM"))
    assert s.declines("C-2") == ["note C-2 ended", "end C-2 refused"]
    assert s.answers("C-1", record())[2:] == ["job C-3/2 elaborator #1", "note C-3 elaborating"]


def test_what_is_parsed_and_waits_for_its_turn_can_be_paused_and_halted():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    s.parsed(kind="control", verb="PAUSE", object="C-2")
    assert s.state.commands["C-2"].pause_wanted
    assert s.halts("C-2")[-2:] == ["note C-2 ended", "end C-2 halted"]
    assert s.answers("C-1", record()) == ["job C-1/2 elaborator #1", "note C-1 elaborating"]


def test_the_order_given_outlives_the_broker():
    s = Harness()
    s.says("FIRST")
    s.says("SECOND")
    s.answers("C-2", record())
    s.state = wire.decoder(State)(wire.encode(s.state))
    assert s.handle(BrokerRestarted) == ["job C-1/1 parser #2"]
    assert s.answers("C-1", record())[-1] == "note C-2 held"


def test_control_does_not_wait_for_its_turn():
    s = Harness()
    s.says("FIRST")
    s.parsed(kind="control", verb="ABORT", object="C-1")
    assert s.outcome("C-1").kind is OutcomeKind.ABORTED
    assert s.outcome("C-2").kind is OutcomeKind.SUCCEEDED
    assert s.state.intake_order == {}


@pytest.mark.parametrize("verb", ["ABORT", "PAUSE"])
def test_control_of_an_arm_reaches_earlier_sentences_of_its_client_and_not_later_ones(verb):
    s = Harness()
    s.says("MOVE RIGHT-ARM")
    s.says(f"{verb} RIGHT-ARM")
    s.says("MOVE RIGHT-ARM")
    s.answers("C-3", record())
    assert s.answers("C-2", record(kind="control", verb=verb, hand="RIGHT-ARM")) == []
    s.answers("C-1", record())
    assert s.outcome("C-2").kind is OutcomeKind.SUCCEEDED
    assert (s.phase("C-1"), s.phase("C-3")) == (("gone", "elaborating") if verb == "ABORT" else ("elaborating", "held"))
    assert verb == "ABORT" or not s.state.commands["C-3"].pause_wanted


@pytest.mark.parametrize("target", [{"object": "C-1"}, {"hand": "BOTH-ARMS"}, {}])
def test_control_of_all_or_of_a_command_waits_for_no_parser(target):
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS")
    s.parsed(kind="control", verb="ABORT", **target)
    assert s.phase("C-1") == "halting"
    assert s.phase("C-2") == ("parsing" if "object" in target else "gone")


def test_control_of_an_arm_does_not_wait_for_another_client():
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS", client="bob")
    s.parsed(kind="control", verb="ABORT", hand="RIGHT-ARM")
    assert s.phase("C-1") == "halting"


def test_halt_of_an_arm_waits_for_no_parser_whichever_way_it_came():
    s = Harness()
    s.executing()
    s.says("A PARSER HANGS WITH THIS")
    s.parsed("FREEZE THE RIGHT ONE", kind="control", verb="HALT", hand="RIGHT-ARM")
    assert s.phase("C-1") == "halting"


def test_a_command_that_needs_more_than_it_names_is_not_overtaken():
    s = Harness()
    s.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    s.parsed()
    s.parsed()
    assert s.phase("C-3") == "held"
    assert s.answers("C-2", script(resources=("RIGHT-ARM", "LEFT-ARM"))) == ["note C-2 held"]
    s.reports("C-1")
    assert s.answers("C-1", go_on())[-2:] == ["job C-2/3 elaborator #1", "note C-2 elaborating"]
    assert s.phase("C-3") == "held"
