"""Reads a recording back, also one without an end, and puts its story in words."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from rtc.apps.observers.recording import HEADER
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError
from rtc.wording import notes as wording
from rtc.wording.advice import in_one_line

ARM_TOPIC = "/rtc/arms/"
RECORD_BYTES = 64 << 20  # maximum length of one record
CHUNK_BYTES = 16 << 20  # maximum length of an unpacked chunk; those of `rtc record` are far shorter
STORY_BYTES = 256 << 20  # maximum length of all messages of the story, which are in memory together
#: what the libraries raise for damaged records; the last two for a length of many digits
DAMAGE = (McapError, zstandard.ZstdError, msgspec.MsgspecError, ValueError, RecursionError, OverflowError, MemoryError)
NAME_CHARACTERS = 100  # maximum length of an attachment's name
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
    room = STORY_BYTES
    with open(path, "rb") as file:
        try:
            for record in _records(file):
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    if (channel := channels.get(record.channel_id)) is None:
                        raise NotARecording(f"{path} is damaged: a message belongs to no channel of the file")
                    room -= _take(run, channel.topic, record)
                    if room < 0:
                        words = f"the story in {path} has more than {STORY_BYTES >> 20} MB"
                        raise NotARecording(f"{words}; open it in Foxglove, Lichtblick or Rerun")
                else:
                    _take_other(run, record)
        except (EndOfFile, struct.error):
            pass  # cut off: all complete chunks have been read; the second is raised for a cut length
        except DAMAGE as error:
            raise NotARecording(f"{path} is damaged, or not a recording of rtc: {error}") from None
    if not run.about:
        raise NotARecording(f"{path} is not a recording of rtc: it has no metadata {HEADER!r}")
    run.events.sort(key=lambda pair: (pair[0], not isinstance(pair[1], m.CommandRecord)))
    return run


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """The records of a file, those in chunks too. Raises McapError or ValueError for one that is too long."""
    for record in StreamReader(file, emit_chunks=True, record_size_limit=RECORD_BYTES).records:
        if not isinstance(record, Chunk):
            yield record
        elif record.compression not in ("", "zstd"):
            raise ValueError(f"a chunk is compressed by {record.compression[:20]!r}, which rtc record does not use")
        else:
            packed = record.compression == "zstd"
            length = max(record.uncompressed_size, zstandard.frame_content_size(record.data) if packed else 0)
            if length > CHUNK_BYTES:
                raise ValueError(f"a chunk of {length:,} bytes; the limit is {CHUNK_BYTES:,}")
            yield from breakup_chunk(record)


def _take(run: RecordedRun, topic: str, record: Message) -> int:
    """Take a message; returns the bytes that the story keeps of it."""
    at_s = record.publish_time / 1e9
    run.first_s = min(run.first_s or at_s, at_s)
    run.last_s = max(run.last_s, at_s)
    if (decode := _read.get(topic)) is not None:
        run.events.append((at_s, decode(record.data)))
        return len(record.data)
    if topic.startswith(ARM_TOPIC):
        run.arms[topic.removeprefix(ARM_TOPIC)] = _read_arm(record.data)
    return 0


def _take_other(run: RecordedRun, record: McapRecord) -> None:
    match record:
        case Metadata(name=name, metadata=about) if name == HEADER:
            run.about = about
        case Attachment(name=name, data=data):
            run.attachments[name] = data
        case DataEnd():
            run.complete = True


def extract(run: RecordedRun, folder: Path) -> tuple[list[Path], list[str]]:
    """Write the attachments into a directory. Returns the files, and the names that are not names of a file there.

    Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    paths, left_out = [], []
    for name, data in run.attachments.items():
        if name in ("", ".", "..") or "/" in name or not name.isprintable() or len(name) > NAME_CHARACTERS:
            left_out.append(name)
        else:
            paths.append(folder / name)
            paths[-1].write_bytes(data)
    return paths, left_out


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
    repeats = note.kind is m.NoteKind.JUDGED and not (note.found or note.drift)  # the step, which is shown already
    words = "" if repeats else wording.in_words(note)
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
            clears = f"; to clear: {in_one_line(refusal.clears)}" if refusal.clears else ""
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
