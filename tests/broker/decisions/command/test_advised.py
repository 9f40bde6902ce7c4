"""The same advice is not given twice in a row."""

from __future__ import annotations

import pytest

from broker.decisions import events
from rtc.protocol import causes
from rtc.protocol.advice import Advice, Alternative, by_person, by_sentence
from rtc.protocol.outcomes import Refusal, RefusalReason
from tests.broker.harness import Harness, bound, go_on, record, script


def given(s: Harness, text: str) -> str:
    """A sentence that is parsed, now or before."""
    s.says(text)
    command = f"C-{s.state.accepted}"
    if s.phase(command) == "parsing":
        s.answers(command, record())
    return command


def refused(
    s: Harness, text: str, clears: Advice, reason: RefusalReason = RefusalReason.SUSPECT, already: str = ""
) -> Advice:
    """The advice that a sentence ends with, if a worker gives this one."""
    command = given(s, text)
    job = s.state.commands[command].job
    cause = causes.AlreadyDone(object=already) if already else None
    why = Refusal(reason=reason, message="the frame of X is suspect", clears=clears, cause=cause)
    s.handle(events.JobDeclined, job=job.id, attempt=job.attempt, node="worker", refusal=why)
    left: Advice = s.outcome(command).refusal.clears
    return left


def done(s: Harness, text: str) -> None:
    command = given(s, text)
    s.answers(command, script())
    s.answers(command, bound(f"{command}.1"))
    s.reports(command)
    s.answers(command, go_on())


LOCATE = by_sentence("LOCATE X")
STATED = [Alternative(words="SET X FRAME x y z CM", states=["X.frame"])]
OPERATOR = by_sentence("GIVE RIGHT-ARM TO OPERATOR")
AGAIN = [Alternative(again=True)]


@pytest.mark.parametrize(
    ("advice", "left"),
    [
        ([*LOCATE, *STATED], STATED),
        ([Alternative(sentences=["LOCATE X"], again=True), *OPERATOR], OPERATOR),
        (by_sentence("LOCATE X", "LIFT X BY 3 CM"), by_sentence("LIFT X BY 3 CM")),
    ],
)
def test_what_was_done_in_vain_is_left_out(advice: Advice, left: Advice) -> None:
    s = Harness()
    assert refused(s, "GRASP X", advice) == advice
    done(s, "LOCATE X")
    assert refused(s, "GRASP X", advice) == left


def test_what_was_tried_without_success_is_left_out() -> None:
    """LOCATE X had failed, and was advised again."""
    s = Harness()
    refused(s, "GRASP X", [*LOCATE, *STATED])
    assert refused(s, "LOCATE X", by_person("look for it")) == by_person("look for it")
    assert refused(s, "GRASP X", [*LOCATE, *STATED]) == STATED


def test_advice_that_was_not_followed_names_who_got_it_and_what_tells_more() -> None:
    """The words were the same, each time."""
    s = Harness()
    made = [refused(s, "GRASP X", LOCATE) for _ in range(4)]
    assert made[0] == LOCATE
    for n, one in enumerate(made[1:], 1):
        assert one[:-1] == LOCATE
        assert not one[-1].sentences
        assert f"C-{n}:" in one[-1].words
        assert f"rtc why C-{n + 1}" in one[-1].words


def test_two_sentences_do_not_advise_each_other() -> None:
    s = Harness()
    advice = [*by_sentence("LIFT X BY 3 CM"), *by_sentence("RELEASE X")]
    assert refused(s, "PLACE X ON Y", advice) == advice
    assert refused(s, "LIFT X BY 3 CM", [*by_sentence("PLACE X ON Y"), *OPERATOR]) == OPERATOR


@pytest.mark.parametrize("reason", [RefusalReason.RESOURCE, RefusalReason.OVERLOAD])
def test_what_was_only_not_possible_at_that_time_stays(reason: RefusalReason) -> None:
    s = Harness()
    refused(s, "GRASP X", LOCATE)
    refused(s, "LOCATE X", by_person("wait for C-7"), reason)
    assert refused(s, "GRASP X", LOCATE)[:-1] == LOCATE


def test_what_helps_after_its_own_advice_was_followed_stays() -> None:
    """LOCATE X may see it now."""
    s = Harness()
    refused(s, "LOCATE X", by_sentence("STOW LEFT-ARM"))
    assert refused(s, "GRASP X", LOCATE) != LOCATE
    s = Harness()
    refused(s, "LOCATE X", by_sentence("STOW LEFT-ARM"))
    done(s, "STOW LEFT-ARM")
    assert refused(s, "GRASP X", LOCATE) == LOCATE


def test_other_figures_of_a_statement_stay() -> None:
    s = Harness()
    refused(s, "GRASP X", STATED)
    refused(s, "SET X FRAME 900 0 0 CM", by_person("a place in the cell"))
    assert refused(s, "GRASP X", STATED)[:1] == STATED


def test_after_the_rest_of_a_task_that_is_done_nothing_is_left() -> None:
    s, advice = Harness(), by_sentence("RETRACT RIGHT-ARM", words="if it is still at X")
    assert refused(s, "RELEASE X", advice, already="X") == advice
    done(s, "RETRACT RIGHT-ARM")
    (left,) = refused(s, "RELEASE X", advice, already="X")
    assert not left.sentences


def test_where_nothing_is_left_the_trace_is_named() -> None:
    s, advice = Harness(), [Alternative(sentences=["LOCATE X"], again=True)]
    refused(s, "GRASP X", advice)
    done(s, "LOCATE X")
    (left,) = refused(s, "GRASP X", advice)
    assert not left.sentences
    assert "rtc why C-3" in left.words


def test_the_same_again_is_advised_once() -> None:
    s = Harness()
    assert refused(s, "LOCATE X", AGAIN) == AGAIN
    (left,) = refused(s, "LOCATE X", AGAIN)
    assert not left.again
    assert "rtc why" in left.words


def test_another_sentence_in_between_may_have_changed_the_world() -> None:
    s = Harness()
    refused(s, "GRASP X", LOCATE)
    done(s, "LOCATE X")
    done(s, "STOW LEFT-ARM")
    assert refused(s, "GRASP X", LOCATE) == LOCATE


def test_other_advice_is_given_as_it_is() -> None:
    s = Harness()
    refused(s, "GRASP X", LOCATE)
    done(s, "LOCATE X")
    retract = by_sentence("RETRACT RIGHT-ARM")
    assert refused(s, "GRASP X", retract) == retract
