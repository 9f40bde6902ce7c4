"""How messages become bytes, and nothing else: the only file that knows.

A message travels as two frames, `PROTOCOL` and a MessagePack map (after the routing frame that ZeroMQ's
ROUTER sockets add). A reader names the union it is willing to hear; anything else is a `WireError` that says
what was wrong, never an exception of the codec.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from rtc.outcomes import WireError

PROTOCOL = b"RTC1"
MAX_BYTES = 8 << 20  # of one frame; ZeroMQ drops the peer that sends more
NAME_CHARACTERS = 1_000  # of a message that is none; what is kept has shorter ones

_encoder = msgspec.msgpack.Encoder()
_NO_MESSAGE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, ValueError, OverflowError)


def encode(value: Any) -> bytes:
    """The MessagePack bytes of a message or of a part of one."""
    return _encoder.encode(value)


def raw(value: Any) -> msgspec.Raw:
    """A value as already encoded bytes, to be put inside a message."""
    return msgspec.Raw(_encoder.encode(value))


def frames(message: Any) -> list[bytes]:
    """What to hand to `send_multipart`."""
    return [PROTOCOL, _encoder.encode(message)]


def reader(union: Any) -> Callable[[Sequence[bytes]], Any]:
    """A function from the two frames of a message to one of the types in `union`.

    Raises `WireError`: not two frames, another protocol version, malformed bytes, a type not in the union.
    """
    decode = msgspec.msgpack.Decoder(union).decode

    def read(parts: Sequence[bytes]) -> Any:
        if len(parts) != 2:
            raise WireError(f"expected 2 frames, {PROTOCOL!r} and a map, got {len(parts)}")
        if parts[0] != PROTOCOL:
            raise WireError(f"expected protocol {PROTOCOL!r}, got {bytes(parts[0][:16])!r}")
        try:
            return decode(parts[1])
        except _NO_MESSAGE as error:
            raise WireError(str(error)) from None

    return read


class _Named(msgspec.Struct):
    request: str = ""
    halt: str = ""


_read_name = msgspec.msgpack.Decoder(_Named).decode


def name_in(parts: Sequence[bytes]) -> str:
    """What its sender calls a message that is none of the protocol, so that he learns which it was; empty when it
    cannot be seen, or is too long to be said again."""
    try:
        named = _read_name(parts[-1])
    except (*_NO_MESSAGE, IndexError):
        return ""
    name = named.request or named.halt
    return name if len(name) <= NAME_CHARACTERS else ""


def decoder(kind: Any) -> Callable[[bytes | msgspec.Raw], Any]:
    """A function from bytes to `kind`, for parts of a message (job inputs and products)."""
    decode = msgspec.msgpack.Decoder(kind).decode

    def read(data: bytes | msgspec.Raw) -> Any:
        try:
            return decode(data)
        except _NO_MESSAGE as error:
            raise WireError(str(error)) from None

    return read
