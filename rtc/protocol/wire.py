"""Encoding of messages: the only module that converts between messages and bytes.

A message has two frames, `PROTOCOL` and a MessagePack map (after the routing frame that ROUTER sockets of ZeroMQ add).
A reader is made for a union of message types. Anything else raises a `WireError` with the reason, never an exception
of the codec.

In place of the map there may be an array of up to `MAX_BATCH` maps. It has all messages of one loop iteration for
one peer, in order. A process sends arrays only to a peer that has announced that it reads them.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar, cast

import msgspec

from rtc.protocol.knots import Knots
from rtc.protocol.outcomes import WireError

Encoded = TypeVar("Encoded")

PROTOCOL = b"RTC1"
MAX_BYTES = 8 << 20  # maximum size of a frame; ZeroMQ disconnects a peer that sends a larger one
MAX_BATCH = 64  # maximum number of messages in an array; it is read as a whole and must not delay a halt
MAX_BATCH_BYTES = 192 << 10  # maximum size of an array; below the frame limit of every socket that takes arrays
NAME_CHARACTERS = 1_000  # maximum length of a name read from an invalid message; valid ones are shorter


def _to_wire(value: Any) -> Any:
    """Knots as their bytes. A number of numpy as one of Python: one that slips into a report must not end the process
    that sends it."""
    if isinstance(value, Knots):
        return value.data
    if isinstance(value, numbers.Real):
        return float(value)
    raise TypeError(f"no message may contain a {type(value).__name__}")


def _from_wire(kind: type, value: Any) -> Any:
    if kind is Knots and isinstance(value, bytes):
        return Knots(value)
    raise ValueError(f"expected bytes, got {type(value).__name__}")


def _decoder(kind: Any) -> Callable[[bytes | msgspec.Raw], Any]:
    return msgspec.msgpack.Decoder(kind, dec_hook=_from_wire).decode


_encoder = msgspec.msgpack.Encoder(enc_hook=_to_wire)
_NO_MESSAGE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, ValueError, OverflowError)


def encode(value: Any) -> bytes:
    """The MessagePack bytes of a message or of a part of one."""
    return _encoder.encode(value)


def raw(value: Any) -> msgspec.Raw:
    """A value as already encoded bytes, to be put inside a message."""
    return msgspec.Raw(_encoder.encode(value))


def opaque(value: msgspec.Raw, kind: type[Encoded]) -> Encoded:
    """Already encoded bytes in the place of a value of this type, in a message that is only sent."""
    return cast(Encoded, value)


def frames(message: Any) -> list[bytes]:
    """The frames for `send_multipart`."""
    return [PROTOCOL, _encoder.encode(message)]


def reader(union: Any) -> Callable[[Sequence[bytes]], Any]:
    """A function from the two frames of a message to one of the types in `union`.

    Raises `WireError`: not two frames, another protocol version, malformed bytes, a type not in the union.
    """
    decode = _decoder(union)

    def read(parts: Sequence[bytes]) -> Any:
        body = _body(parts)
        try:
            return decode(body)
        except _NO_MESSAGE as error:
            raise WireError(str(error)) from None

    return read


def reader_of_many(union: Any) -> Callable[[Sequence[bytes]], Sequence[Any]]:
    """As `reader`, but for a peer that may send arrays: the messages, in order.

    One invalid map makes its whole array invalid; `split` separates them.
    """
    read = reader(union | Annotated[list[union], msgspec.Meta(max_length=MAX_BATCH)])

    def read_many(parts: Sequence[bytes]) -> Sequence[Any]:
        found = read(parts)
        return found if type(found) is list else (found,)

    return read_many


def split(parts: Sequence[bytes]) -> list[Sequence[bytes]]:
    """The maps of an array as separate messages, each to be decoded alone; any other message unchanged."""
    try:
        body = _body(parts)
        bodies = _read_array(body) if body[:1] in _ARRAY else ()
    except (WireError, *_NO_MESSAGE):
        bodies = ()
    if not bodies:
        return [parts]
    return [[PROTOCOL, bytes(body)] for body in bodies]


def together(messages: Sequence[Any]) -> list[list[bytes]]:
    """The frames to send for these messages (or already encoded parts), in order.

    Messages are combined to arrays within the limits; a single one is sent as a map.
    """
    found: list[list[bytes]] = []
    for first in range(0, len(messages), MAX_BATCH):
        some = messages[first : first + MAX_BATCH]
        body = _encoder.encode(some if len(some) > 1 else some[0])
        if len(some) == 1 or len(body) <= MAX_BATCH_BYTES:
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


_ARRAY = {*(bytes([first]) for first in range(0x91, 0xA0)), b"\xdc", b"\xdd"}  # first byte of an array in MessagePack
_read_array = msgspec.msgpack.Decoder(Annotated[list[msgspec.Raw], msgspec.Meta(max_length=MAX_BATCH)]).decode


class _Named(msgspec.Struct):
    request: str = ""
    halt: str = ""


class _Typed(msgspec.Struct):
    type: str = ""


_read_type = msgspec.msgpack.Decoder(_Typed).decode
_read_name = msgspec.msgpack.Decoder(_Named).decode


def name_in(parts: Sequence[bytes]) -> str:
    """The sender's name of an invalid message, so that an answer can refer to it.

    Empty if it cannot be read or is longer than NAME_CHARACTERS.
    """
    try:
        named = _read_name(parts[-1])
    except (*_NO_MESSAGE, IndexError):
        return ""
    name = named.request or named.halt
    return name if len(name) <= NAME_CHARACTERS else ""


def is_hello(parts: Sequence[bytes]) -> bool:
    """Whether an invalid message is a hello by its type."""
    try:
        return _read_type(parts[-1]).type.endswith("Hello")
    except (*_NO_MESSAGE, IndexError):
        return False


def decoder(kind: Any) -> Callable[[bytes | msgspec.Raw], Any]:
    """A function from bytes to `kind`, for parts of a message (job inputs and products)."""
    decode = _decoder(kind)

    def read(data: bytes | msgspec.Raw) -> Any:
        try:
            return decode(data)
        except _NO_MESSAGE as error:
            raise WireError(str(error)) from None

    return read
