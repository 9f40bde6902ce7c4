"""Traces: one per command, steps and phases below it, halts as events and links, the caller above it."""

from __future__ import annotations

import pytest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SpanExportResult
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from rtc.apps.observers.feed import Received
from rtc.apps.observers.traces import ReportingExporter, Traces
from rtc.protocol import messages as m
from rtc.protocol.messages import NoteKind, Phase
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason
from rtc.protocol.traceparent import traceparent_of, with_traceparent
from tests.apps.observers.samples import STEP, STOWED, SUCCEEDED, ended, note, received

TRACEPARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"
HALTED = Outcome(kind=OutcomeKind.HALTED, message="halted (LEFT-ARM)", stop=StopReason.HALT)


def spans_of(messages) -> list[ReadableSpan]:
    exporter = InMemorySpanExporter()
    traces = Traces("run1", exporter=exporter)
    for message in messages:
        traces.take(received(message))
    traces.close()
    return list(exporter.get_finished_spans())


def roots(spans: list[ReadableSpan]) -> dict[str, ReadableSpan]:
    return {span.attributes["rtc.command"]: span for span in spans if span.name == "command"}


def below(spans: list[ReadableSpan], span: ReadableSpan) -> list[ReadableSpan]:
    return [one for one in spans if one.parent is not None and one.parent.span_id == span.context.span_id]


def seconds(span: ReadableSpan) -> float:
    return (span.end_time - span.start_time) / 1e9


def test_a_command_is_a_trace_of_steps_and_phases():
    spans = spans_of(STOWED)
    command = roots(spans)["C-1"]
    children = below(spans, command)
    assert [span.name for span in children] == ["parsing", "elaborating", "step"]
    phases = below(spans, children[2])
    assert [span.name for span in phases] == ["binding", "executing", "analyzing"]
    assert children[2].attributes["rtc.step"] == STEP
    assert seconds(command) == pytest.approx(1.05, abs=1e-6)
    assert seconds(phases[1]) == pytest.approx(1.0, abs=1e-6)
    assert phases[1].attributes["rtc.node"] == "MCM"
    assert {span.context.trace_id for span in (command, *children, *phases)} == {command.context.trace_id}


def test_two_commands_are_two_traces_and_a_refusal_is_an_error():
    both = roots(spans_of(STOWED))
    assert both["C-1"].context.trace_id != both["C-2"].context.trace_id
    assert both["C-1"].status.is_ok
    assert not both["C-2"].status.is_ok
    assert both["C-2"].attributes["rtc.refusal"] == "sentence"


def test_a_halt_is_an_event_and_a_link_in_both_directions():
    messages = [
        *STOWED[:4],
        note(5, 0.5, Phase.HALTING, "C-2", kind=NoteKind.HALT, about="LEFT-ARM"),
        note(6, 0.5, Phase.HALTING, step=STEP, kind=NoteKind.STOPPING, about="LEFT-ARM"),
        note(7, 0.6, Phase.ENDED, "C-2", kind=NoteKind.OUTCOME, node="MCM"),
        ended(8, 0.6, SUCCEEDED, "C-2", "HALT LEFT-ARM", took_s=0.1),
        note(9, 0.61, Phase.ENDED, kind=NoteKind.OUTCOME),
        ended(10, 0.61, HALTED),
    ]
    found = roots(spans_of(messages))
    halted, halt = found["C-1"], found["C-2"]
    assert [event.name for event in halted.events] == ["halt"]
    assert [link.context.span_id for link in halted.links] == [halt.context.span_id]
    assert [link.context.trace_id for link in halt.links] == [halted.context.trace_id]


def test_a_halt_of_another_scope_is_not_linked():
    messages = [
        *STOWED[:4],
        note(5, 0.5, Phase.HALTING, "C-2", kind=NoteKind.HALT, about="RIGHT-ARM"),
        note(6, 0.5, Phase.HALTING, step=STEP, kind=NoteKind.STOPPING, about="LEFT-ARM"),
        ended(7, 0.6, HALTED),
    ]
    command = roots(spans_of(messages))["C-1"]
    assert not command.links
    assert command.events


def test_the_caller_of_a_command_is_above_it():
    request = with_traceparent("alice/1f-7", TRACEPARENT)
    end = m.CommandEnded(seq=7, at_s=1001.0, command="C-1", request=request, text="STOW", outcome=SUCCEEDED, took_s=1.0)
    command = roots(spans_of([*STOWED[:6], end]))["C-1"]
    assert f"{command.context.trace_id:032x}" in TRACEPARENT
    assert f"{command.parent.span_id:016x}" in TRACEPARENT
    assert command.parent.is_remote


def test_a_link_to_a_command_of_a_caller_names_the_trace_of_the_caller():
    record = m.CommandRecord(
        command="C-2",
        text="HALT LEFT-ARM",
        source="operator",
        request=with_traceparent("bob/1", TRACEPARENT),
        accepted_at_s=1000.5,
        phase=Phase.HALTING,
    )
    exporter = InMemorySpanExporter()
    traces = Traces("run1", exporter=exporter)
    for message in (
        *STOWED[:4],
        note(5, 0.5, Phase.HALTING, "C-2", kind=NoteKind.HALT, about="LEFT-ARM"),
        record,
        note(6, 0.5, Phase.HALTING, step=STEP, kind=NoteKind.STOPPING, about="LEFT-ARM"),
        ended(7, 0.6, HALTED),
    ):
        traces.take(received(message) if message is not record else Received(1000.5, record))
    traces.close()
    (link,) = roots(list(exporter.get_finished_spans()))["C-1"].links
    assert f"{link.context.trace_id:032x}" in TRACEPARENT


@pytest.mark.parametrize(
    "wrong",
    [
        "00-0AF7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01",
        "00-00000000000000000000000000000000-b7ad6b7169203331-01",
        "00-0af7651916cd43dd8448eb211c80319c-0000000000000000-01",
        "01-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01",
        "something",
    ],
)
def test_an_invalid_trace_context_is_refused_and_never_read(wrong):
    with pytest.raises(ValueError, match="traceparent"):
        with_traceparent("alice/1", wrong)
    assert traceparent_of(f"alice/1;{wrong}") is None


def test_a_request_keeps_its_trace_context():
    found = traceparent_of(with_traceparent("a;b/1", TRACEPARENT))
    assert found is not None
    assert (f"{found.trace:032x}", f"{found.span:016x}", found.flags) == (*TRACEPARENT.split("-")[1:3], 1)
    assert traceparent_of("alice/1") is None
    with pytest.raises(ValueError, match="characters"):
        with_traceparent("x" * 150, TRACEPARENT)


class Collector(InMemorySpanExporter):
    """One that fails while it is down."""

    down = True

    def export(self, spans):
        return SpanExportResult.FAILURE if self.down else super().export(spans)


def test_a_collector_that_fails_is_reported_once_and_again_when_it_is_back(caplog):
    collector = Collector()
    exporter = ReportingExporter(collector, "http://collector")
    spans = spans_of(STOWED)
    for _ in range(3):
        assert exporter.export(spans) is SpanExportResult.FAILURE
    assert len(caplog.records) == 1
    collector.down = False
    exporter.export(spans)
    exporter.export(spans)
    assert len(caplog.records) == 2
    assert str(3 * len(spans)) in caplog.records[1].getMessage()
