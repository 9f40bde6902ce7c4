"""A sentence that was parsed before needs no parser."""

from __future__ import annotations

import pytest

from broker.decisions import parsed_before
from broker.decisions.events import ProgramInstalled
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import RefusalReason
from rtc.wording.advice import in_one_line
from tests.broker.harness import Harness, record


@pytest.fixture
def s():
    story = Harness()
    story.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="grammar")
    return story


def parse(s, text, **head):
    """A command with these words, parsed; the elaborator refuses it, so that it occupies no arm."""
    command = s.parsed(text, **head)
    s.declines(command)
    return command


def is_parsed(s, text):
    """Whether this sentence needs no parser."""
    return any("elaborator" in line for line in s.says(text))


def test_a_repeated_sentence_is_elaborated_at_once(s):
    parse(s, "GRASP", hand="LEFT-ARM")
    effects = ["tell ann Accepted C-2", "note C-2 parsing", "job C-2/2 elaborator #1", "note C-2 elaborating"]
    assert s.says("GRASP") == effects
    assert s.state.commands["C-2"].head.hand == "LEFT-ARM"
    assert s.state.counts["parsed_before"] == 1


def test_it_keeps_its_place_behind_the_earlier_sentences_of_its_client(s):
    parse(s, "GRASP")
    s.says("PLACE")
    assert s.says("GRASP")[1:] == ["note C-3 parsing"]
    assert "job C-3/2 elaborator #1" in s.answers("C-2", record(hand="LEFT-ARM"))


def test_what_is_refused_for_its_place_is_refused_again(s):
    s.says("STOW AFTER LAST", client="bob")
    s.answers("C-1", record(after="LAST"))
    s.says("STOW AFTER LAST", client="cid")
    again, before = s.outcome("C-2").refusal, s.outcome("C-1").refusal
    assert (again.reason, again.where, again.expected) == (before.reason, before.where, before.expected)
    assert "C-1" in in_one_line(again.clears)  # the same advice is not given anew


@pytest.mark.parametrize("other", ["another program", "other words", "refused before", "a long sentence"])
def test_a_parser_is_asked_for(s, other):
    text = "GRASP" + " X" * (parsed_before.CHARACTERS if other == "a long sentence" else 1)
    if other == "refused before":
        s.says(text)
        s.declines("C-1", RefusalReason.SENTENCE)
    else:
        parse(s, text)
    if other == "another program":
        s.handle(ProgramInstalled, kind=WorkerKind.PARSER, digest="newer")
    assert "job C-2/1 parser #1" in s.says("GRASP  X" if other == "other words" else text)


def test_the_number_of_records_has_a_limit(s):
    for n in range(parsed_before.MAX_PARSED + 1):
        parse(s, f"GRASP {n}")
    assert len(s.state.parsed) <= parsed_before.MAX_PARSED
    assert is_parsed(s, f"GRASP {parsed_before.MAX_PARSED}")
    assert not is_parsed(s, "GRASP 0")


def test_a_snapshot_has_the_records(s):
    parse(s, "GRASP")
    s.state = wire.decoder(State)(wire.encode(s.state))
    assert is_parsed(s, "GRASP")
