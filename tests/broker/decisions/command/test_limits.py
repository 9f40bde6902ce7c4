"""Time limits of halts and of the last analysis."""

from __future__ import annotations

import pytest

from broker.decisions.command.limits import CLOSING_LIMIT_S, REPORT_MARGIN_S
from broker.decisions.events import (
    BrokerRestarted,
)
from rtc.protocol.outcomes import OutcomeKind, StopReason
from tests.broker.harness import Harness, give_up


def time_left(s: Harness, command: str = "C-1") -> float:
    return s.state.commands[command].due_s - s.now


@pytest.mark.parametrize(("timeout_scale", "limit_s"), [(0.5, 2.0), (1.0, 2.0), (3.0, 6.0)])
def test_every_kind_of_halt_has_the_same_time_limit(timeout_scale, limit_s):
    by_sentence, by_socket = Harness(), Harness()
    for s in (by_sentence, by_socket):
        s.state.timeout_scale = timeout_scale
        s.executing()
    by_sentence.says("HALT ALL")
    by_socket.halts()
    assert time_left(by_sentence, "C-2") == time_left(by_sentence) == time_left(by_socket) == pytest.approx(limit_s)


def test_after_a_restart_a_halt_has_its_limit_and_time_to_reconnect():
    s = Harness()
    s.state.timeout_scale = 3.0
    s.executing()
    s.says("HALT ALL")
    s.handle(BrokerRestarted)
    assert time_left(s) == time_left(s, "C-2") == pytest.approx(6.0 + REPORT_MARGIN_S)


def test_after_a_restart_the_last_analysis_has_its_whole_limit():
    s = Harness()
    s.executing()
    s.halts()
    s.reports("C-1", StopReason.HALT)
    assert s.phase("C-1") == "closing"
    s.handle(BrokerRestarted)
    assert time_left(s) == pytest.approx(CLOSING_LIMIT_S)


def test_an_overdue_report_and_an_unconfirmed_halt_end_with_advice():
    s = Harness()
    s.executing()
    s.rings("C-1")
    assert s.phase("C-1") == "halting"
    s.reports("C-1", StopReason.HALT)
    s.answers("C-1", give_up(StopReason.HALT))
    late = s.outcome("C-1")
    s.executing()
    s.halts("C-2")
    s.rings("C-2")
    s.answers("C-2", give_up(StopReason.HALT))
    unconfirmed = s.outcome("C-2")
    assert late.refusal.clears
    assert unconfirmed.kind is OutcomeKind.HALT_NOT_CONFIRMED
    assert unconfirmed.refusal.clears


def test_of_an_overdue_report_and_then_no_rest_the_cause_comes_first():
    s = Harness()
    s.executing()
    s.rings("C-1")
    s.rings("C-1")
    s.answers("C-1", give_up(StopReason.HALT))
    outcome = s.outcome("C-1")
    assert (outcome.kind, outcome.stop) == (OutcomeKind.HALT_NOT_CONFIRMED, StopReason.TIMEOUT)
    assert outcome.message.startswith("MCM gave no end report within")  # wording: the cause comes first
