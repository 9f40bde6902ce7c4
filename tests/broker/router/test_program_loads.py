"""Programs are checked one after the other, and meanwhile other clients are served."""

from __future__ import annotations

from typing import ClassVar

import pytest

from broker.persistence.program_loads import MAX_WAITING, ProgramLoads
from rtc.programs.sandbox import CheckRequest, CheckResult
from rtc.protocol import messages as m
from rtc.protocol.digest import digest
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.versions import VERSION
from tests.broker.router.bench import Bench


class Slow:
    """A check that is done when the test says so."""

    started: ClassVar[list[Slow]] = []

    def __init__(self, asked: CheckRequest) -> None:
        self.asked, self.checked = asked, None
        self.started.append(self)

    def result(self, now: float) -> CheckResult | None:
        return self.checked


@pytest.fixture
def slow(bench: Bench) -> Bench:
    Slow.started = []
    bench.router.core.loads = ProgramLoads(bench.router.core.store, Slow)
    return bench


def program_text(request: str, body: bytes = b"x") -> m.ProgramText:
    return m.ProgramText(request=request, kind=m.WorkerKind.PARSER, name="mine.lark", body=body)


def test_no_one_waits_for_a_program_that_is_checked(slow: Bench) -> None:
    assert slow.send("front", b"ann", program_text("1")) == []
    (reply,) = slow.send("front", b"bob", m.StatusQuery(request="q"))
    assert isinstance(reply, m.StatusReply)
    Slow.started[0].checked = CheckResult(error="mine.lark: it takes more than 3 s")
    (declined,) = slow.send("front", b"ann", m.ClientHello(protocol=VERSION, client="ann"))[1:]
    assert declined.refusal.message == "mine.lark: it takes more than 3 s"  # wording: of the check


def test_programs_are_checked_one_after_the_other_each_upon_the_one_before(slow: Bench) -> None:
    slow.send("front", b"ann", program_text("1"), program_text("1"), program_text("2"))
    (first,) = Slow.started
    first.checked = CheckResult(merged=b"first", changes=["a change"])
    loaded = [a for a in slow.send("front", b"ann", m.Heartbeat(name="ann")) if isinstance(a, m.ProgramLoaded)]
    assert [answer.changes for answer in loaded] == [["a change"]]
    assert Slow.started[1].asked.program == b"first"
    assert slow.state.programs["parser"] == digest(b"first")


def test_too_many_programs_at_once_are_declined(slow: Bench) -> None:
    answers = []
    for n in range(MAX_WAITING + 1):
        slow.now += 1.0
        answers += slow.send("front", b"ann", program_text(str(n)))
    assert [answer.refusal.reason for answer in answers] == [RefusalReason.OVERLOAD]
