"""The true scene of `rtc look --watch`: asked for again after a restart, and not where there is none."""

from __future__ import annotations

import pytest

from rtc.apps.cli.look import _Eye
from rtc.protocol.outcomes import KeyTrouble, TimedOut


class Asked:
    """A client whose simulator fails once, and then answers."""

    def __init__(self, failure: Exception) -> None:
        self._answers = [failure, "truth"]

    def truth(self):
        answer = self._answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.mark.parametrize(("failure", "then"), [(TimedOut("restarting"), "truth"), (KeyTrouble("far"), None)])
def test_a_simulator_that_was_late_is_asked_again(failure, then):
    eye = _Eye(Asked(failure), cell=None)
    assert eye._truth() is None
    assert eye._truth() == then
