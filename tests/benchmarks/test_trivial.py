"""The trivial worker functions take a sentence all the way, by the same types as the real ones."""

from __future__ import annotations

import pytest

from benchmarks.load import trivial
from benchmarks.load.subsystem import REPEAT_S, Instant
from benchmarks.load.trivial import FUNCTIONS, PERFORMERS, SUBSYSTEM, sentence
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, StopReason

K = m.WorkerKind


def through(kind, data):
    """The function's product for an input that has been bytes, as bytes and back."""
    function = FUNCTIONS[kind]
    product = function.run(function.compile(b"any"), None, None, wire.decoder(function.INPUT)(wire.encode(data)))
    return wire.decoder(type(product))(wire.encode(product))


@pytest.fixture
def bound():
    parsed = through(K.PARSER, m.ParserInput(text=sentence(7)))
    script = through(K.ELABORATOR, m.ElaboratorInput(command="C-1", parsed=parsed))
    assert script.resources == ["LOAD-7"]
    return through(
        K.BINDER, m.BinderInput(primitive_id="C-1.1", context=script.context, step=script.steps[0], bindings={})
    )


def test_a_sentence_becomes_one_primitive_for_the_performer_it_names(bound):
    assert (bound.subsystem, bound.primitive.id, bound.primitive.performer) == (SUBSYSTEM, "C-1.1", "LOAD-7")
    assert bound.limit_s > 0


@pytest.mark.parametrize(("reason", "verdict"), [(StopReason.GOAL, "continue"), (StopReason.TIMEOUT, "abort")])
def test_its_report_is_judged(bound, reason, verdict):
    (report,) = Instant(1, ["LOAD-7"]).handle(m.Execute(primitive=bound.primitive), 0.0)
    report = m.EndReport(**{name: getattr(report, name) for name in report.__struct_fields__} | {"reason": reason})
    data = m.AnalyzerInput(evaluation=bound.evaluation, report=report)
    assert through(K.ANALYZER, data).verdict == verdict


def test_another_sentence_is_refused():
    assert isinstance(through(K.PARSER, m.ParserInput(text="MOVE LOAD-1 NOW")), Refusal)


def test_many_sentences_in_a_row_name_different_performers():
    assert len({sentence(n) for n in range(PERFORMERS)}) == PERFORMERS
    assert sentence(PERFORMERS) == sentence(0)


def test_a_busy_function_gives_the_same_after_its_work():
    data = m.ParserInput(text=sentence(1))
    assert trivial.busy(trivial.parse, 0.001)(data) == trivial.parse(data)


def test_the_instant_subsystem_keeps_a_report_until_it_is_acknowledged(bound):
    instant = Instant(1, ["LOAD-7"])
    (report,) = instant.handle(m.Execute(primitive=bound.primitive), 1.0)
    assert instant.overdue(1.0 + REPEAT_S / 2) == []
    assert instant.overdue(1.1 + REPEAT_S) == [report]
    assert instant.hello()[0].outstanding == ["C-1.1"]
    assert instant.handle(m.ReportAck(primitive="C-1.1"), 2.0) == []
    assert instant.overdue(9.0) == []
    assert [type(x) for x in instant.handle(m.HelloWanted(), 2.0)] == [m.SubsystemHello]


def test_a_halt_is_answered_at_once():
    started, rest = Instant(1, ["LOAD-7"]).handle(m.HaltOrder(halt="h"), 1.0)
    assert (started.halt, rest.halt, rest.at_rest) == ("h", "h", True)
