"""The TEST sentences that a client sends for a list, and for one sentence."""

from __future__ import annotations

import pytest

from rtc.client.rehearsing import following, rehearsals
from rtc.protocol.messages import CommandEnded
from rtc.protocol.outcomes import Outcome, OutcomeKind

OUTCOME = Outcome(kind=OutcomeKind.SUCCEEDED)
DONE = CommandEnded(seq=1, at_s=0.0, command="C-1", request="1", text="", outcome=OUTCOME, took_s=0.0)


@pytest.mark.parametrize("given", ["STOW RIGHT-ARM.", ["STOW RIGHT-ARM"], ["STOW RIGHT-ARM", "STOW LEFT-ARM"]])
def test_one_sentence_is_tested_as_a_list_of_one(given) -> None:
    asking = rehearsals(given)
    asked = [next(asking).text]
    while (more := following(asking, DONE)) is not None:
        asked.append(more.text)
    assert asked == ["TEST STOW RIGHT-ARM", "TEST STOW LEFT-ARM"][: len(asked)]
    assert len(asked) == (1 if isinstance(given, str) else len(given))
