"""How messages become bytes, and nothing else: the only file that knows.

A message travels as two frames, `PROTOCOL` and a MessagePack map (after the routing frame that ZeroMQ's
ROUTER sockets add). A reader names the union it is willing to hear; anything else is a `WireError` that says
what was wrong, never an exception of the codec.

In place of the map there may be an array of up to `MOST_TOGETHER` maps: the messages that one process had for another
in one turn of its loop, in their order. A process sends arrays only to a peer that has announced that it reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import msgspec

from rtc.protocol.outcomes import WireError

PROTOCOL = b"RTC1"
MAX_BYTES = 8 << 20  # of one frame; ZeroMQ drops the peer that sends more
MOST_TOGETHER = 64  # messages in one array: it is read as a whole, so it must not hold up a halt
MOST_BYTES_TOGETHER = 192 << 10  # of an array; below the frame limit of every socket that takes arrays
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
        body = _body(parts)
        try:
            return decode(body)
        except _NO_MESSAGE as error:
            raise WireError(str(error)) from None

    return read


def reader_of_many(union: Any) -> Callable[[Sequence[bytes]], Sequence[Any]]:
    """As `reader`, but for a peer that may send arrays: the messages, in order. One bad map spoils its array; see
    `apart`."""
    read = reader(union | Annotated[list[union], msgspec.Meta(max_length=MOST_TOGETHER)])

    def read_many(parts: Sequence[bytes]) -> Sequence[Any]:
        found = read(parts)
        return found if type(found) is list else (found,)

    return read_many


def apart(parts: Sequence[bytes]) -> list[Sequence[bytes]]:
    """The maps of an array as messages of their own, so that each can be judged alone; of anything else, itself."""
    try:
        body = _body(parts)
        bodies = _read_array(body) if body[:1] in _ARRAY else ()
    except (WireError, *_NO_MESSAGE):
        bodies = ()
    if not bodies:
        return [parts]
    return [[PROTOCOL, bytes(body)] for body in bodies]


def together(messages: Sequence[Any]) -> list[list[bytes]]:
    """The frames to send for these messages (or parts that are encoded already), in order: arrays as long as the
    bounds allow, and maps for those that stay alone."""
    found: list[list[bytes]] = []
    for first in range(0, len(messages), MOST_TOGETHER):
        some = messages[first : first + MOST_TOGETHER]
        body = _encoder.encode(some if len(some) > 1 else some[0])
        if len(some) == 1 or len(body) <= MOST_BYTES_TOGETHER:
            found.append([PROTOCOL, body])
        else:
            middle = len(some) // 2
            found += together(some[:middle]) + together(some[middle:])
    return found


def _body(parts: Sequence[bytes]) -> bytes:
    """The second frame of a message of this protocol. Raises `WireError`."""
    if len(parts) != 2:
        raise WireError(f"expected 2 frames, {PROTOCOL!r} and a map, got {len(parts)}")
    if parts[0] != PROTOCOL:
        raise WireError(f"expected protocol {PROTOCOL!r}, got {bytes(parts[0][:16])!r}")
    return parts[1]


_ARRAY = {*(bytes([first]) for first in range(0x91, 0xA0)), b"\xdc", b"\xdd"}  # how MessagePack begins one
_read_array = msgspec.msgpack.Decoder(Annotated[list[msgspec.Raw], msgspec.Meta(max_length=MOST_TOGETHER)]).decode


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
