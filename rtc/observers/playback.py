"""Reads a recording back, also one without an end, and puts its story in words."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from rtc.observers.recording import HEADER
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError

ARM_TOPIC = "/rtc/arms/"
Event = m.CommandRecord | m.Event
_read: dict[str, Callable[[bytes], Event]] = {
    "/rtc/commands": msgspec.json.Decoder(m.CommandRecord).decode,
    "/rtc/progress": msgspec.json.Decoder(m.ProgressNote).decode,
    "/rtc/outcomes": msgspec.json.Decoder(m.CommandEnded).decode,
    "/rtc/refusals": msgspec.json.Decoder(m.RequestRefused).decode,
    "/rtc/halts": msgspec.json.Decoder(m.HaltRequested).decode,
}
_read_arm = msgspec.json.Decoder(m.ArmSample).decode


class NotARecording(RtcError):
    """The file is not an MCAP file, or one of another program."""


@dataclass
class RecordedRun:
    """What a recording contains. Times are Unix time (s)."""

    about: dict[str, str] = field(default_factory=dict)  # the metadata record
    events: list[tuple[float, Event]] = field(default_factory=list)
    arms: dict[str, m.ArmSample] = field(default_factory=dict)  # the last sample of each
    attachments: dict[str, bytes] = field(default_factory=dict)
    first_s: float = 0.0
    last_s: float = 0.0
    complete: bool = False  # the recorder has ended in order

    @property
    def outcomes(self) -> dict[str, m.CommandEnded]:
        """The outcome of each ended command, by its number."""
        return {event.command: event for _, event in self.events if isinstance(event, m.CommandEnded)}


def read(path: Path) -> RecordedRun:
    """Read a recording up to its end, or up to where a killed recorder left it. Raises OSError, NotARecording."""
    run = RecordedRun()
    channels: dict[int, Channel] = {}
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    _take(run, channels[record.channel_id].topic, record)
                else:
                    _take_other(run, record)
        except (EndOfFile, struct.error):
            pass  # cut off: all complete chunks have been read; the second is raised for a cut length
        except (McapError, msgspec.MsgspecError, ValueError) as error:
            raise NotARecording(f"{path} is not a recording of rtc: {error}") from None
    if not run.about:
        raise NotARecording(f"{path} is not a recording of rtc: it has no metadata {HEADER!r}")
    run.events.sort(key=lambda pair: (pair[0], not isinstance(pair[1], m.CommandRecord)))
    return run


def _take(run: RecordedRun, topic: str, record: Message) -> None:
    at_s = record.publish_time / 1e9
    run.first_s = min(run.first_s or at_s, at_s)
    run.last_s = max(run.last_s, at_s)
    if (decode := _read.get(topic)) is not None:
        run.events.append((at_s, decode(record.data)))
    elif topic.startswith(ARM_TOPIC):
        run.arms[topic.removeprefix(ARM_TOPIC)] = _read_arm(record.data)


def _take_other(run: RecordedRun, record: McapRecord) -> None:
    match record:
        case Metadata(name=name, metadata=about) if name == HEADER:
            run.about = about
        case Attachment(name=name, data=data):
            run.attachments[name] = data
        case DataEnd():
            run.complete = True


def extract(run: RecordedRun, folder: Path) -> list[Path]:
    """Write the attachments into a directory; returns the files. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, data in run.attachments.items():
        paths.append(folder / Path(name).name)
        paths[-1].write_bytes(data)
    return paths


def in_words(run: RecordedRun) -> Iterator[str]:
    """The story, a line per event; times in seconds since the first message."""
    began = time.strftime("from %Y-%m-%d %H:%M:%S", time.localtime(run.first_s)) if run.first_s else "without a message"
    cluster = f"cluster {run.about['cluster']}, " if run.about.get("cluster") else ""
    yield f"{cluster}cell {run.about.get('cell', '?')}, {began}, {run.last_s - run.first_s:.1f} s"
    yield "each line: time, command, the phase that begins; in brackets what ended the phase before, after how long"
    phases: dict[str, tuple[m.Phase, str]] = {}  # command -> its phase and step
    for at_s, event in run.events:
        if isinstance(event, m.ProgressNote):
            if event.phase is m.Phase.ENDED:
                continue  # the outcome follows
            before, phases[event.command] = phases.get(event.command), (event.phase, event.step)
            line = _progress(event, begins=before != phases[event.command])
            if not line:
                continue
        else:
            line = _line(event)
        yield f"{at_s - run.first_s:9.3f} s  {getattr(event, 'command', ''):<6} {line}"
    for name, arm in sorted(run.arms.items()):
        yield f"{name} at the end: {' '.join(f'{value:.4f}' for value in arm.joints)} rad"
    if not run.complete:
        yield "the file has no end: its recorder still writes, or was killed; shown up to the last written chunk"


def _progress(note: m.ProgressNote, *, begins: bool) -> str:
    """`begins`: this is the first note of its phase. Otherwise phase and step are left out, and the line is empty if
    nothing else is new."""
    words = note.note if note.note != note.step.partition(": ")[2] else ""  # analyzers repeat the step
    took = f", {_duration(note.took_s)}" if note.took_s else ""
    result = f"({note.node}{took}{': ' + words if words else ''})" if note.node else words
    parts = [f"{note.phase.value:<11}", note.step, result] if begins else [" " * 11, result]
    if not (begins or words or note.warning):
        return ""
    return ("WARNING " if note.warning else "") + " ".join(filter(None, parts)).rstrip()


def _duration(took_s: float) -> str:
    return f"{took_s:.2f} s" if took_s >= 1.0 else f"{1e3 * took_s:.1f} ms"


def _line(event: m.CommandRecord | m.CommandEnded | m.RequestRefused | m.HaltRequested) -> str:
    match event:
        case m.CommandRecord(text=text, source=source):
            return f"accepted from the {source}: {text}"
        case m.CommandEnded(outcome=outcome, text=text, took_s=took_s):
            why = f": {outcome.message}" if outcome.message else ""
            return f"{outcome.kind.value.upper().replace('_', ' ')} after {took_s:.3f} s  {text}{why}"
        case m.RequestRefused(request=request, refusal=refusal, text=text):
            clears = f"; to clear: {refusal.clears}" if refusal.clears else ""
            return f"NOT ACCEPTED {text or f'request {request}'}: {refusal.message}{clears}"
        case m.HaltRequested(halt=halt, scope=scope, refused=refused):
            return f"HALT {scope}" + (f" refused: {refused}" if refused else f" requested ({halt})")


def as_json(run: RecordedRun) -> dict[str, Any]:
    """The story for --json: events with Unix times, and the last sample of each arm."""
    return {
        "about": run.about,
        "complete": run.complete,
        "events": [{"at": at_s, **msgspec.to_builtins(event)} for at_s, event in run.events],
        "arms": msgspec.to_builtins(run.arms),
    }
