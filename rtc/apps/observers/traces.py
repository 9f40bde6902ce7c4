"""OpenTelemetry traces: one trace per command, with a span per step and per phase; halts as events and links.

A command's spans are made when it ends, from its notes. The identifiers of its root span follow from the run and the
command's number. So another command can link to it before it has ended.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, NamedTuple

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import Event, ReadableSpan
from opentelemetry.sdk.trace.export import BatchSpanProcessor, SpanExporter, SpanExportResult
from opentelemetry.sdk.trace.id_generator import RandomIdGenerator
from opentelemetry.sdk.util.instrumentation import InstrumentationScope
from opentelemetry.trace import Link, SpanContext, SpanKind, Status, StatusCode, TraceFlags

from rtc.apps.observers.feed import Received
from rtc.protocol import messages as m
from rtc.protocol.messages import NoteKind, Phase
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.traceparent import TraceParent, traceparent_of
from rtc.wording.notes import in_words

LOG = logging.getLogger("rtc observe")
SCOPE = InstrumentationScope("rtc")
EXPORT_S = 5.0  # limit for one request to the collector
DELAY_S = 1.0  # longest time that a span waits for others
MAX_COMMANDS = 10_000  # commands in progress whose notes are kept, and ended ones whose trace context is kept
PATH = "/v1/traces"  # of an OTLP collector


class ReportingExporter(SpanExporter):
    """Passes spans on; logs when the collector begins to fail, and when it accepts again."""

    def __init__(self, to: SpanExporter, name: str) -> None:
        self._to, self._name = to, name
        self._lost = 0  # spans since the collector failed

    def export(self, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        result = self._to.export(spans)
        if result is SpanExportResult.SUCCESS:
            if self._lost:
                LOG.warning("%s accepts traces again; %d spans are lost", self._name, self._lost)
            self._lost = 0
            return result
        if not self._lost:
            LOG.warning("%s does not accept traces; their spans are lost until it does", self._name)
        self._lost += len(spans)
        return result

    def shutdown(self) -> None:
        self._to.shutdown()

    def force_flush(self, timeout_millis: int = 30_000) -> bool:
        return self._to.force_flush(timeout_millis)


class PhaseSpan(NamedTuple):
    """A command's time in one phase of one step, on the clock of the notes (s)."""

    phase: Phase
    step: str
    begin_s: float
    end_s: float
    node: str  # process that did the work
    words: str  # its result


@dataclass
class TracedCommand:
    """A command in progress: its notes, and the commands to link to."""

    notes: list[m.ProgressNote] = field(default_factory=list)
    halts: str = ""  # scope, if it is a HALT sentence
    links: list[str] = field(default_factory=list)


class Traces:
    """Makes and sends the spans of one run. `url`: of an OTLP/HTTP collector, such as http://localhost:4318.

    `exporter`: in place of the one for `url`. `shares_clock`: times of the notes are of this machine's clock.
    """

    def __init__(self, run: str, url: str = "", *, exporter: SpanExporter | None = None, shares_clock: bool = True):
        endpoint = url if url.endswith(PATH) else url.rstrip("/") + PATH
        self._run, self._shares_clock = run, shares_clock
        self._resource = Resource.create({"service.name": "rtc", "service.instance.id": run or "unknown"})
        self._new_span_id = RandomIdGenerator().generate_span_id
        logging.getLogger("opentelemetry.exporter").setLevel(logging.CRITICAL)  # we report it ourselves, once
        to = exporter or ReportingExporter(OTLPSpanExporter(endpoint=endpoint, timeout=EXPORT_S), url)
        self._ended = BatchSpanProcessor(to, schedule_delay_millis=1e3 * DELAY_S)
        self._offset_s = time.time() - time.monotonic()
        self._commands: dict[str, TracedCommand] = {}
        self._parents: dict[str, TraceParent] = {}
        self._last_halt: dict[str, str] = {}  # scope -> the HALT sentence that was the last with it

    def take(self, received: Received) -> None:
        match received.message:
            case m.ProgressNote() as note if note.command and note.seq:
                self._take_note(note)
            case m.CommandRecord(command=command, request=request):
                self._keep_parent(command, request)
            case m.CommandEnded() as ended:
                self._keep_parent(ended.command, ended.request)
                if not self._shares_clock:
                    self._offset_s = time.time() - (time.monotonic() - received.at_s) - ended.at_s
                if (followed := self._commands.pop(ended.command, None)) is not None:
                    self._export(ended, followed)  # otherwise its notes were not published

    def close(self) -> None:
        """Send what is left, within EXPORT_S."""
        self._ended.force_flush(int(1e3 * EXPORT_S))
        self._ended.shutdown()  # type: ignore[no-untyped-call]

    def _take_note(self, note: m.ProgressNote) -> None:
        command = self._commands.setdefault(note.command, TracedCommand())
        if note.kind is NoteKind.HALT:
            command.halts = note.about
            self._last_halt[note.about] = note.command
        elif note.kind is NoteKind.STOPPING and note.about:
            self._link(note.command, self._last_halt.get(note.about, ""))
        command.notes.append(note)
        while len(self._commands) > MAX_COMMANDS:
            del self._commands[next(iter(self._commands))]

    def _link(self, halted: str, halt: str) -> None:
        if (by := self._commands.get(halt)) is not None:
            by.links.append(halted)
            self._commands[halted].links.append(halt)

    def _keep_parent(self, command: str, request: str) -> None:
        if (parent := traceparent_of(request)) is not None:
            self._parents[command] = parent
            while len(self._parents) > MAX_COMMANDS:
                del self._parents[next(iter(self._parents))]

    # --- spans ----------------------------------------------------------------------------------------

    def _root(self, command: str) -> SpanContext:
        """The context of a command's root span."""
        digest = hashlib.sha256(f"{self._run} {command}".encode()).digest()
        parent = self._parents.get(command)
        trace = parent.trace if parent else int.from_bytes(digest[:16])
        flags = TraceFlags(parent.flags if parent else TraceFlags.SAMPLED)
        return SpanContext(trace, int.from_bytes(digest[16:24]), is_remote=False, trace_flags=flags)

    def _caller(self, command: str) -> SpanContext | None:
        parent = self._parents.get(command)
        return parent and SpanContext(parent.trace, parent.span, is_remote=True, trace_flags=TraceFlags(parent.flags))

    def _export(self, ended: m.CommandEnded, followed: TracedCommand) -> None:
        root, outcome = self._root(ended.command), ended.outcome
        for step, group in groupby(segments(followed.notes, ended.at_s), key=lambda segment: segment.step):
            self._export_step(root, step, list(group))
        failed = outcome.kind is not OutcomeKind.SUCCEEDED
        self._send(
            "command",
            root,
            self._caller(ended.command),
            kind=SpanKind.SERVER,
            start_time=self._ns(ended.at_s - ended.took_s),
            end_time=self._ns(ended.at_s),
            events=list(self._events(followed.notes)),
            links=[Link(self._root(command)) for command in followed.links],
            status=Status(StatusCode.ERROR, outcome.message) if failed else Status(),
            attributes={
                "rtc.command": ended.command,
                "rtc.sentence": ended.text,
                "rtc.outcome": outcome.kind.value,
                "rtc.steps_done": outcome.steps_done,
                "rtc.trims": outcome.trims,
                **({"rtc.stop": outcome.stop.value} if outcome.stop else {}),
                **({"rtc.refusal": outcome.refusal.reason.value} if outcome.refusal else {}),
            },
        )

    def _events(self, notes: list[m.ProgressNote]) -> Iterator[Event]:
        for note in notes:
            words = {"rtc.note": in_words(note)}
            if note.kind in (NoteKind.HALT, NoteKind.STOPPING):
                yield Event("halt", words, self._ns(note.at_s))
            if note.warning:
                yield Event("warning", words, self._ns(note.at_s))

    def _export_step(self, root: SpanContext, step: str, parts: list[PhaseSpan]) -> None:
        """The phases of a step, below its span; phases without a step are below the command."""
        above = self._below(root) if step else root
        for part in parts:
            about = {"rtc.node": part.node, "rtc.note": part.words}
            attributes = {name: value for name, value in about.items() if value}
            begin, end = self._ns(part.begin_s), self._ns(part.end_s)
            self._send(part.phase, self._below(root), above, start_time=begin, end_time=end, attributes=attributes)
        if step:
            begin, end = self._ns(parts[0].begin_s), self._ns(parts[-1].end_s)
            self._send("step", above, root, start_time=begin, end_time=end, attributes={"rtc.step": step})

    def _below(self, root: SpanContext) -> SpanContext:
        """The context of a new span of the same trace."""
        return SpanContext(root.trace_id, self._new_span_id(), is_remote=False, trace_flags=root.trace_flags)

    def _send(self, name: str, context: SpanContext, parent: SpanContext | None, **about: Any) -> None:
        """Queue a finished span for the collector. A tracer, made for spans in progress, would need twice the time."""
        self._ended.on_end(
            ReadableSpan(name, context, parent, resource=self._resource, instrumentation_scope=SCOPE, **about)
        )

    def _ns(self, at_s: float) -> int:
        return int(1e9 * (at_s + self._offset_s))


def segments(notes: list[m.ProgressNote], end_s: float) -> Iterator[PhaseSpan]:
    """The phases of a command in order. A note names the phase that begins, and the process that ended the last one."""
    begin: m.ProgressNote | None = None
    words = ""
    for note in notes:
        if begin is not None and (note.phase, note.step) != (begin.phase, begin.step):
            yield PhaseSpan(begin.phase, begin.step, begin.at_s, note.at_s, note.node, in_words(note) or words)
            begin = None
        if begin is None and note.phase is not Phase.ENDED:
            begin, words = note, ""
        else:
            words = in_words(note) or words
    if begin is not None:  # its last note is missing
        yield PhaseSpan(begin.phase, begin.step, begin.at_s, end_s, "", words)
