"""What `rtc do` says about its sentences."""

from __future__ import annotations

import pytest
import typer

from rtc.apps.cli.sentence_files import SentenceLine
from rtc.apps.cli.sentences import advised, hand_in, quotes_forgotten
from rtc.protocol.advice import Alternative, by_sentence
from rtc.protocol.messages import CommandRecord, Phase
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason, RequestDeclined


@pytest.mark.parametrize(
    ("texts", "kinds", "hinted"),
    [
        (["STOW", "RIGHT-ARM"], ["refused", "not_sent"], True),
        (["STOW", "RIGHT-ARM"], ["refused"], True),  # as with --no-wait
        (["HALT", "RIGHT-ARM"], ["succeeded", "refused"], True),
        (["STOW"], ["refused"], False),
        (["STOW LEFT-LEG", "HALT"], ["refused", "not_sent"], False),
        (["HALT", "HALT"], ["succeeded", "succeeded"], False),
    ],
)
def test_single_words_that_are_refused_may_be_a_sentence_without_its_quotes(
    texts: list[str], kinds: list[str], hinted: bool
) -> None:
    hint = quotes_forgotten(texts, [{"text": text, "kind": kind} for text, kind in zip(texts, kinds, strict=False)])

    assert hint.endswith(f'rtc do "{" ".join(texts)}"') if hinted else hint == ""


def record(*clears: Alternative) -> CommandRecord:
    why = Refusal(reason=RefusalReason.STATE, message="no way", clears=[*clears])
    outcome = Outcome(kind=OutcomeKind.REFUSED, refusal=why)
    about = {"command": "C-2", "text": "GRASP X", "source": "operator", "request": "r", "accepted_at_s": 0.0}
    return CommandRecord(**about, phase=Phase.ENDED, outcome=outcome)


def test_an_advice_is_followed_by_its_number() -> None:
    first = Alternative(sentences=["STOW A", "LOCATE X"], again=True)
    assert advised(record(first, *by_sentence("STOW B", instead=True)), 1) == ["STOW A", "LOCATE X", "GRASP X"]
    assert advised(record(first, *by_sentence("STOW B", instead=True)), 2) == ["STOW B"]


@pytest.mark.parametrize(
    ("one", "n"),
    [
        (Alternative(words="look what is in the way"), 1),
        (Alternative(sentences=["SET X FRAME 1 2 3 CM"], states=["X.frame"]), 1),
        (Alternative(sentences=["STOW A"]), 2),
    ],
)
def test_what_only_a_person_can_do_is_not_performed(one: Alternative, n: int) -> None:
    with pytest.raises(typer.Exit):
        advised(record(one), n)


class FullCluster:
    """A client of a cluster that accepts one command."""

    def __init__(self) -> None:
        self.number = ""

    def submit(self, text: str, **_: object) -> FullCluster:
        if self.number:
            raise RequestDeclined(Refusal(reason=RefusalReason.OVERLOAD, message="2000 commands are live"))
        self.number = "C-1"
        return self


def test_what_is_handed_in_to_a_full_cluster_says_what_was_not_sent(capsys: pytest.CaptureFixture[str]) -> None:
    texts = ["STOW LEFT-ARM", "STOW RIGHT-ARM", "LOCATE MACS-NEW"]
    code, results = hand_in(FullCluster(), [SentenceLine("", text) for text in texts], json=False, if_tested="")
    assert code == 2
    assert [one["kind"] for one in results] == ["accepted", "refused", "not_sent"]
    assert "NOT SENT  LOCATE MACS-NEW" in capsys.readouterr().out
