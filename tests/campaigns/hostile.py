"""Hostile input for every socket of a cluster: malformed bytes, and well-formed messages with wrong values.

    for parts in bad_messages("front", random.Random(1)): ...      # frames, endless, by seed alone
    Attacker(context, settings, "front", rng).say(1000)

Messages that decode are the more dangerous kind. Each type that a socket accepts is built from its annotations, with
hostile values: NaN, integers at the limits of 64 bits, names of other peers, unknown job ids, deep nesting, long texts.
`ACCEPTED` lists the message types that each socket accepts.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import random
import socket as unix
from collections.abc import Callable, Iterator, Sequence
from typing import Any, get_args

import msgspec
import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.runtime.settings import ENDPOINTS, Settings

#: Endpoint -> accepted message types. Shutdown is left out: a permitted peer that sends it means it. The last two
#: endpoints only publish; input there is ignored.
ACCEPTED: dict[str, Any] = {
    "front": m.ClientHello
    | m.CommandText
    | m.StatusQuery
    | m.TraceQuery
    | m.ProgramQuery
    | m.ProgramText
    | m.Heartbeat,
    "halt": m.ToHalt,
    "workers": m.WorkerToBroker,
    "subsystems": m.SubsystemToBroker,
    "supervisor": m.SupervisorToBroker,
    "world": m.ToWorld,
    "estop": m.ToHalt,
    "bench": m.ToSim,
    "events": m.ProgressNote,
    "telemetry": m.Telemetry,
}
NAMES = [
    *("C-1", "C-1.1", "C-1/1", "C-0", "C-", "C--1", "C-1e9", "C-99999999999999999999999", f"C-{'9' * 5000}", "c-1"),
    *("ALL", "RIGHT-ARM", "LEFT-ARM", "MACS-OLD", "MACS-OLD.frame", "MACS-NEW.mass", ".", "", " ", "MCM", "broker"),
    *("binder@2", "parser@0", "parser@", "@", "unknown@99", "supervisor", "world", "H-1", "stop-C-1", "orphan-C-1.1"),
    *("\0", "a\nb", "‮", "😀", "[red]", "%s%n", "../../etc/passwd", "'; DROP TABLE facts;--", "x" * 300, "x" * 70_000),
]
SENTENCES = ["STOW LEFT-ARM", "HALT C-1", "ABORT ALL", "PAUSE", "(" * 3000, "STOW " * 4000, "STOW LEFT-ARM\0", "é" * 99]
INTEGERS = [0, 1, -1, 2, 7, 255, 1 << 31, (1 << 63) - 1, -(1 << 63), (1 << 64) - 1]
FLOATS = [0.0, -0.0, 1.0, -1.0, 1e-320, 1e9, 1e308, -1e308, math.inf, -math.inf, math.nan]
IDENTITIES = [b"\xff\xfe", b"a b", b"x" * 255, "é".encode(), b"MCM2", b"parser", b"@", b"broker"]
IMPOSTORS = {"workers": [b"parser@0", b"analyzer@3"], "subsystems": [b"MCM"], "supervisor": [b"supervisor", b"world"]}
DEEP = 200_000  # levels of nesting


# --- bytes ---------------------------------------------------------------------------------------------


def bad_messages(endpoint: str, rng: random.Random) -> Iterator[list[bytes]]:
    """An endless sequence of messages (frames) for one endpoint; equal seeds give equal sequences."""
    kinds = _types(ACCEPTED[endpoint])
    while True:
        yield rng.choice(FAMILIES)(kinds, rng)


def _random_bytes(_: list[Any], rng: random.Random) -> list[bytes]:
    return [rng.randbytes(rng.choice((0, 1, 4, 50, 3000))) for _ in range(rng.choice((1, 1, 2, 2, 3, 10)))]


def _random_body(_: list[Any], rng: random.Random) -> list[bytes]:
    return [wire.PROTOCOL, rng.randbytes(rng.choice((0, 1, 20, 300)))]


def _truncated(kinds: list[Any], rng: random.Random) -> list[bytes]:
    body = _good(kinds, rng)[1]
    return [wire.PROTOCOL, body[: rng.randrange(len(body))]]


def _flipped(kinds: list[Any], rng: random.Random) -> list[bytes]:
    body = bytearray(_good(kinds, rng)[1])
    for _ in range(rng.choice((1, 1, 3, 20))):
        body[rng.randrange(len(body))] = rng.randrange(256)
    return [wire.PROTOCOL, bytes(body)]


def _wrong_protocol(kinds: list[Any], rng: random.Random) -> list[bytes]:
    return [rng.choice((b"RTC0", b"RTC2", b"", b"rtc1", b"RTC1" * 9, rng.randbytes(4))), _good(kinds, rng)[1]]


def _frames_too_many(kinds: list[Any], rng: random.Random) -> list[bytes]:
    return _good(kinds, rng) * rng.choice((2, 5)) + [b""] * rng.choice((0, 1, 300))


def _frames_too_few(kinds: list[Any], rng: random.Random) -> list[bytes]:
    return [rng.choice(_good(kinds, rng))]


def _wrong_type(_: list[Any], rng: random.Random) -> list[bytes]:
    kinds = _types(ACCEPTED[rng.choice(list(ACCEPTED))])
    return _good([kind for kind in kinds if kind is not m.Shutdown], rng)


def _deep_nest(kinds: list[Any], rng: random.Random) -> list[bytes]:
    """Nesting deeper than any stack: as a whole body, or as one value of a message (known or unknown key)."""
    nest = rng.choice((b"\x91", b"\x81\xa1x", b"\x92\xc0")) * DEEP + b"\xc0"
    if rng.random() < 0.5:
        return [wire.PROTOCOL, nest]
    kind = rng.choice(kinds)
    field = rng.choice([*kind.__struct_fields__, "unknown"])
    head = msgspec.msgpack.encode({"type": kind.__name__})[1:]
    return [wire.PROTOCOL, b"\x82" + head + msgspec.msgpack.encode(field) + nest]


def _false_lengths(_: list[Any], rng: random.Random) -> list[bytes]:
    """A few bytes that announce gigabytes."""
    kind = rng.choice((b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9"))
    return [wire.PROTOCOL, kind + b"\xff\xff\xff\xf0" + b"\x01" * 9]


def _wide(_: list[Any], rng: random.Random) -> list[bytes]:
    """A body just below the maximum frame size: one long text, or a long list."""
    size = rng.choice((100_000, 1_000_000, wire.MAX_BYTES - 100))
    body = rng.choice(
        (
            lambda: msgspec.msgpack.encode({"type": "CommandText", "request": "r", "text": "A" * (size - 60)}),
            lambda: msgspec.msgpack.encode([None] * (size - 60)),
            lambda: msgspec.msgpack.encode({"type": "ReadView", "request": "r", "keys": ["a"] * ((size - 60) // 2)}),
            lambda: msgspec.msgpack.encode({"type": "HaltOrder", "halt": "H" * (size - 60)}),
        )
    )()
    return [wire.PROTOCOL, body]


def _beyond_the_limit(_: list[Any], __: random.Random) -> list[bytes]:
    """A frame above the maximum size: ZeroMQ disconnects the sender."""
    return [wire.PROTOCOL, bytes(wire.MAX_BYTES + 1)]


def _hostile(kinds: list[Any], rng: random.Random) -> list[bytes]:
    return [wire.PROTOCOL, msgspec.msgpack.encode(hostile(rng.choice(kinds), rng))]


def _good(kinds: list[Any], rng: random.Random) -> list[bytes]:
    return [wire.PROTOCOL, msgspec.msgpack.encode(hostile(rng.choice(kinds), rng))]


FAMILIES: list[Callable[[list[Any], random.Random], list[bytes]]] = [
    *[_hostile] * 12,
    *[_random_bytes, _random_body, _truncated, _flipped, _wrong_protocol] * 2,
    *[_frames_too_many, _frames_too_few, _wrong_type, _deep_nest, _false_lengths],
]
HEAVY = [_wide, _beyond_the_limit, _deep_nest]  # sent a few at a time: they test memory, not the codec


def heavy_messages(rng: random.Random) -> Iterator[list[bytes]]:
    while True:
        yield rng.choice(HEAVY)([m.HaltOrder], rng)


# --- messages that decode ------------------------------------------------------------------------------


def hostile(kind: Any, rng: random.Random) -> Any:
    """A value for a type, by its annotations, filled in by a hostile peer."""
    return _value(msgspec.inspect.type_info(kind), rng, 0)


def _value(info: Any, rng: random.Random, depth: int) -> Any:
    match info:
        case msgspec.inspect.StructType(cls=cls, fields=fields, tag=tag):
            given = [f for f in fields if f.required or rng.random() < 0.8]
            made = {f.encode_name: _value(f.type, rng, depth + 1) for f in given}
            return {info.tag_field: tag, **made} if tag is not None else made
        case msgspec.inspect.UnionType(types=types):
            return _value(rng.choice(types), rng, depth)
        case msgspec.inspect.StrType():
            return rng.choice(SENTENCES) if rng.random() < 0.2 else rng.choice(NAMES)
        case msgspec.inspect.IntType():
            return rng.choice(INTEGERS)
        case msgspec.inspect.FloatType():
            return rng.choice(FLOATS)
        case msgspec.inspect.BoolType():
            return rng.random() < 0.5
        case msgspec.inspect.BytesType():
            return rng.randbytes(rng.choice((0, 32, 5000)))
        case msgspec.inspect.NoneType():
            return None
        case msgspec.inspect.EnumType(cls=cls):
            return rng.choice(list(cls)).value
        case msgspec.inspect.LiteralType(values=values):
            return rng.choice(values)
        case msgspec.inspect.ListType(item_type=item):
            return [_value(item, rng, depth + 1) for _ in range(rng.choice((0, 1, 2, 7)) if depth < 5 else 0)]
        case msgspec.inspect.VarTupleType(item_type=item):
            return [_value(item, rng, depth + 1) for _ in range(rng.choice((0, 1, 2)) if depth < 5 else 0)]
        case msgspec.inspect.DictType(key_type=key, value_type=item):
            pairs = range(rng.choice((0, 1, 3)) if depth < 5 else 0)
            return {_value(key, rng, depth + 1): _value(item, rng, depth + 1) for _ in pairs}
    return _plain(rng, depth)  # Any, Raw


def _plain(rng: random.Random, depth: int) -> Any:
    if depth > 6 or rng.random() < 0.6:
        return rng.choice((None, True, rng.choice(NAMES), rng.choice(INTEGERS), rng.choice(FLOATS), b"\xff"))
    if rng.random() < 0.5:
        return [_plain(rng, depth + 1) for _ in range(3)]
    return {rng.choice(NAMES[:20]): _plain(rng, depth + 1) for _ in range(3)}


def _types(union: Any) -> list[Any]:
    return list(get_args(union)) or [union]


# --- connections ---------------------------------------------------------------------------------------


class Attacker:
    """One connection to one endpoint that never reads an answer. Messages that do not fit its queue are not sent."""

    def __init__(
        self,
        context: zmq.Context[Any],
        settings: Settings,
        endpoint: str,
        rng: random.Random,
        identities: Sequence[bytes] = IDENTITIES,
    ) -> None:
        self._address, self._messages = settings.endpoint(endpoint), bad_messages(endpoint, rng)
        self._context, self._rng, self._identities = context, rng, identities
        self._kind = {"events": zmq.XSUB, "telemetry": zmq.XSUB}.get(endpoint, zmq.DEALER)
        self._socket = self._connect()
        self.sent_count = 0

    def send(self, many: int, messages: Iterator[list[bytes]] | None = None) -> int:
        """Send up to `many` messages; return how many were queued."""
        sent = 0
        for parts in itertools.islice(messages or self._messages, many):
            with contextlib.suppress(zmq.Again):
                self._socket.send_multipart(parts, zmq.NOBLOCK)
                sent += 1
        self.sent_count += sent
        return sent

    def come_anew(self) -> None:
        """Reconnect under another identity."""
        self._socket.close(linger=0)
        self._socket = self._connect()

    def close(self) -> None:
        self._socket.close(linger=0)

    def _connect(self) -> zmq.Socket[bytes]:
        made: zmq.Socket[bytes] = self._context.socket(self._kind)
        made.setsockopt(zmq.LINGER, 0)
        if self._kind == zmq.DEALER and self._rng.random() < 0.8:
            made.setsockopt(zmq.IDENTITY, self._rng.choice([*self._identities, b"\1" + self._rng.randbytes(20)]))
        made.connect(self._address)
        return made


def stream_garbage(settings: Settings, endpoint: str, rng: random.Random) -> None:
    """Raw bytes on the Unix socket: not ZeroMQ, or a ZeroMQ handshake that stops half-way."""
    greeting = b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48)
    ready = b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
    endless = b"\x02" + (1 << 62).to_bytes(8, "big") + b"x" * 100  # a frame of 4 EiB begins
    sent = rng.choice(
        (
            rng.randbytes(500),
            greeting[: rng.randrange(64)],
            greeting + rng.randbytes(300),
            greeting + ready + rng.randbytes(300),
            greeting + ready + endless,
        )
    )
    with unix.socket(unix.AF_UNIX) as line, contextlib.suppress(OSError):
        line.settimeout(0.2)
        line.connect(str(settings.path / ENDPOINTS[endpoint]))
        line.sendall(sent)
