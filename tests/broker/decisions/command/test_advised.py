"""The same advice is not given twice in a row."""

from __future__ import annotations

import pytest

from broker.decisions import events
from rtc.protocol import causes
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
    s: Harness, text: str, clears: str, reason: RefusalReason = RefusalReason.SUSPECT, already: str = ""
) -> str:
    """The advice that a sentence ends with, if a worker gives this one."""
    command = given(s, text)
    job = s.state.commands[command].job
    cause = causes.AlreadyDone(object=already) if already else None
    why = Refusal(reason=reason, message="the frame of X is suspect", clears=clears, cause=cause)
    s.handle(events.JobDeclined, job=job.id, attempt=job.attempt, node="worker", refusal=why)
    return str(s.outcome(command).refusal.clears)


def done(s: Harness, text: str) -> None:
    command = given(s, text)
    s.answers(command, script())
    s.answers(command, bound(f"{command}.1"))
    s.reports(command)
    s.answers(command, go_on())


@pytest.mark.parametrize(
    ("advice", "left"),
    [
        ("LOCATE X, or state where it is: SET X FRAME x y z CM", "state where it is: SET X FRAME x y z CM"),
        ("LOCATE X; then give the sentence again; or GIVE RIGHT-ARM TO OPERATOR", "GIVE RIGHT-ARM TO OPERATOR"),
        ("LOCATE X; LIFT X BY 3 CM", "LIFT X BY 3 CM"),
    ],
)
def test_what_was_done_in_vain_is_left_out(advice: str, left: str) -> None:
    s = Harness()
    assert refused(s, "GRASP X", advice) == advice
    done(s, "LOCATE X")
    assert refused(s, "GRASP X", advice) == left


@pytest.mark.parametrize(("advice", "left"), [("LOCATE X, or SET X FRAME x y z CM", "SET X FRAME x y z CM")])
def test_what_was_tried_without_success_is_left_out(advice: str, left: str) -> None:
    """LOCATE X had failed, and was advised again."""
    s = Harness()
    refused(s, "GRASP X", advice)
    assert refused(s, "LOCATE X", "look for it") == "look for it"
    assert refused(s, "GRASP X", advice) == left


def test_advice_that_was_not_followed_names_who_got_it_and_what_tells_more() -> None:
    """The words were the same, each time."""
    s = Harness()
    words = [refused(s, "GRASP X", "LOCATE X") for _ in range(4)]
    assert len(set(words)) == 4
    assert words[0] == "LOCATE X"
    for n, one in enumerate(words[1:], 1):
        assert one.startswith(f"as for C-{n}: LOCATE X; ")
        assert f"rtc why C-{n + 1}" in one


def test_two_sentences_do_not_advise_each_other() -> None:
    s = Harness()
    assert refused(s, "PLACE X ON Y", "LIFT X BY 3 CM, or RELEASE X") == "LIFT X BY 3 CM, or RELEASE X"
    assert refused(s, "LIFT X BY 3 CM", "PLACE X ON Y; or GIVE RIGHT-ARM TO OPERATOR") == "GIVE RIGHT-ARM TO OPERATOR"


@pytest.mark.parametrize("reason", [RefusalReason.RESOURCE, RefusalReason.OVERLOAD])
def test_what_was_only_not_possible_at_that_time_stays(reason: RefusalReason) -> None:
    s = Harness()
    refused(s, "GRASP X", "LOCATE X")
    refused(s, "LOCATE X", "wait for C-7", reason)
    assert "LOCATE X; rtc why" in refused(s, "GRASP X", "LOCATE X")


def test_what_helps_after_its_own_advice_was_followed_stays() -> None:
    """LOCATE X may see it now."""
    s = Harness()
    refused(s, "LOCATE X", "STOW LEFT-ARM")
    assert refused(s, "GRASP X", "LOCATE X") != "LOCATE X"
    s = Harness()
    refused(s, "LOCATE X", "STOW LEFT-ARM")
    done(s, "STOW LEFT-ARM")
    assert refused(s, "GRASP X", "LOCATE X") == "LOCATE X"


def test_other_figures_of_a_statement_stay() -> None:
    s = Harness()
    refused(s, "GRASP X", "SET X FRAME x y z CM")
    refused(s, "SET X FRAME 900 0 0 CM", "a place in the cell")
    assert "SET X FRAME x y z CM" in refused(s, "GRASP X", "SET X FRAME x y z CM")


def test_after_the_rest_of_a_task_that_is_done_nothing_is_left() -> None:
    s, advice = Harness(), "RETRACT RIGHT-ARM, if it is still at X"
    assert refused(s, "RELEASE X", advice, already="X") == advice
    done(s, "RETRACT RIGHT-ARM")
    assert refused(s, "RELEASE X", advice, already="X").startswith("nothing is left to do")


def test_where_nothing_is_left_the_trace_is_named() -> None:
    s = Harness()
    refused(s, "GRASP X", "LOCATE X; do it again")
    done(s, "LOCATE X")
    words = refused(s, "GRASP X", "LOCATE X; do it again")
    assert words.startswith("LOCATE X has not cleared it: rtc why C-3")


def test_the_same_again_is_advised_once() -> None:
    s = Harness()
    assert refused(s, "LOCATE X", "do it again") == "do it again"
    assert "rtc why" in refused(s, "LOCATE X", "do it again")


def test_another_sentence_in_between_may_have_changed_the_world() -> None:
    s = Harness()
    refused(s, "GRASP X", "LOCATE X")
    done(s, "LOCATE X")
    done(s, "STOW LEFT-ARM")
    assert refused(s, "GRASP X", "LOCATE X") == "LOCATE X"


def test_other_advice_is_given_as_it_is() -> None:
    s = Harness()
    refused(s, "GRASP X", "LOCATE X")
    done(s, "LOCATE X")
    assert refused(s, "GRASP X", "RETRACT RIGHT-ARM first") == "RETRACT RIGHT-ARM first"
