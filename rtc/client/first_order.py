"""A halt order that leaves a new process before it has loaded any library.

`rtc halt` starts with this module alone. It imports `os`, `select`, `socket` and `time`, which cost a few milliseconds;
pyzmq, msgspec and the messages cost hundreds. So it speaks the wire protocol of ZeroMQ (ZMTP 3.0, mechanism NULL, RFC
23) itself, to the local sockets of a cluster. The answers are read later by `rtc.client.halt`, which takes its sockets
over. For a cluster on another machine, whose sockets need CURVE, it is of no use.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import time

from rtc.runtime.priority import may_be_real_time, real_time

TYPE_CHECKING = False  # see rtc/__init__.py
if TYPE_CHECKING:
    from collections.abc import Sequence

RANK = 1  # real-time priority while the order is made and sent, if permitted
CONNECT_S = 0.5  # time limit of the first connection
OTHERS_S = 0.01  # time for the other sockets after the first has the order; the halt line sends it again to the rest

MORE, LONG, COMMAND = 1, 2, 4  # flags of a frame
GREETING = b"\xff" + 8 * b"\0" + b"\x7f" + b"\x03\0" + b"NULL".ljust(20, b"\0") + 32 * b"\0"
READY = b"\x05READY" + b"\x0bSocket-Type" + b"\0\0\0\x06DEALER" + b"\x08Identity" + 4 * b"\0"
HANDS = os.path.join(os.path.dirname(__file__), "..", "language", "hands.txt")


class NotConnected(Exception):
    """A socket that has no connection now (`lost`: no more), or has not received a whole message yet."""

    def __init__(self, lost: bool) -> None:
        super().__init__()
        self.lost = lost


class Dealer:
    """A DEALER socket with one connection. It queues nothing: it sends after the handshake, or not at all."""

    def __init__(self, path: str) -> None:
        """Connect to a Unix socket. Raises OSError without a listener."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        self._read = b""
        self._greeted = self._ready = self._lost = False
        try:
            self._socket.connect(path)
            self._socket.send(GREETING + _frame(READY, COMMAND))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        return self._socket.fileno()

    def send_multipart(self, parts: Sequence[bytes], flags: int = 0) -> None:
        """Send one message; `flags` are those of pyzmq: it never waits. Raises NotConnected."""
        self._receive()
        last = len(parts) - 1
        data = b"".join(_frame(part, MORE if n < last else 0) for n, part in enumerate(parts))
        try:
            if self._lost or not self._ready or self._socket.send(data) != len(data):
                raise NotConnected(self._lost)
        except OSError:
            self._lost = True
            raise NotConnected(self._lost) from None

    def recv_multipart(self, flags: int = 0) -> list[bytes]:
        """The next message that has arrived as a whole; it never waits. Raises NotConnected if there is none."""
        self._receive()
        rest, parts = self._read, []
        while (found := _first_frame(rest)) is not None:
            flags, body, rest = found
            if not flags & COMMAND:
                parts.append(body)
                if not flags & MORE:
                    self._read = rest
                    return parts
        raise NotConnected(self._lost)

    def close(self) -> None:
        self._socket.close()

    def poll(self, timeout_ms: int, flags: int) -> int:
        """Whether it is connected, as `poll(POLLOUT)` of a socket of pyzmq."""
        return flags if self._ready and not self._lost else 0

    def _receive(self) -> None:
        """Read what has arrived, and complete the handshake with it."""
        while not self._lost:
            try:
                got = self._socket.recv(1 << 16)
            except BlockingIOError:
                break
            except OSError:
                got = b""
            self._lost = not got
            self._read += got
        if not self._greeted and len(self._read) >= len(GREETING):
            self._read, self._greeted = self._read[len(GREETING) :], True
        if self._greeted and not self._ready and (found := _first_frame(self._read)) is not None:
            self._read, self._ready = found[2], True


def _frame(body: bytes, flags: int) -> bytes:
    if len(body) > 255:
        return bytes([flags | LONG]) + len(body).to_bytes(8, "big") + body
    return bytes([flags, len(body)]) + body


def _first_frame(data: bytes) -> tuple[int, bytes, bytes] | None:
    """(flags, body, what follows) of the first whole frame."""
    if len(data) < 2:
        return None
    start = 9 if data[0] & LONG else 2
    end = start + int.from_bytes(data[1:start], "big")
    return (data[0], data[start:end], data[end:]) if len(data) >= max(start, end) else None


class FirstOrder:
    """One halt order that has left, or not: `sent_to` has the sockets that took it, by the name of the file."""

    def __init__(self, run_dir: str, scope: str) -> None:
        """Send it to the broker and to every subsystem of arms that listens in `run_dir`."""
        self.called_at_s = time.monotonic()
        self.halt, self.scope = f"H-{os.urandom(6).hex()}", scope_of(scope)
        self.sent_to: dict[str, Dealer] = {}
        with real_time(RANK if may_be_real_time(RANK) else 0):  # else it may wait behind busy processes
            self._send(_listening(run_dir), order(self.halt, self.scope, self.called_at_s))

    def _send(self, dealers: dict[str, Dealer], parts: list[bytes]) -> None:
        limit_s = self.called_at_s + CONNECT_S
        while dealers and (left_s := limit_s - time.monotonic()) > 0:
            select.select(list(dealers.values()), [], [], left_s)
            for name, dealer in list(dealers.items()):
                try:
                    dealer.send_multipart(parts)
                except NotConnected as none:
                    if none.lost:
                        dealers.pop(name).close()
                    continue
                self.sent_to[name] = dealers.pop(name)
                limit_s = min(limit_s, time.monotonic() + OTHERS_S)
        for dealer in dealers.values():
            dealer.close()


def order(halt: str, scope: str, called_at_s: float) -> list[bytes]:
    """The frames of a `HaltOrder`, as `rtc.protocol.wire.frames` makes them (a test compares both).

    Both texts have less than 256 bytes."""
    texts = {"type": "HaltOrder", "halt": halt, "scope": scope}
    body = b"".join(_text(key) + _text(value) for key, value in texts.items())
    return [b"RTC1", b"\x84" + body + _text("called_at_s") + b"\xcb" + struct.pack(">d", called_at_s)]


def scope_of(words: str) -> str:
    """The scope that the words of a caller name: ALL, a performer, a command, or another name; ALL for all else.

    As `rtc.language.fastpath.named_scope`, but for reserved words, comments and tabs (a test compares both)."""
    name = words.strip(" ,.").upper().replace("_", "-")
    with open(HANDS, encoding="utf-8") as hands:
        arm_of = dict(line.split() for line in hands)
    if name.startswith("ARM ") and name[4:] not in arm_of:
        name = name[4:].lstrip(" ")
    parts = name.split("-")
    is_name = len(name) < 200 and name.isascii() and name[:1].isalpha() and all(map(str.isalnum, parts))
    return arm_of.get(name, name) if is_name and name != "BOTH-ARMS" else "ALL"


def _text(value: str) -> bytes:
    data = value.encode()
    return (bytes([0xA0 | len(data)]) if len(data) < 32 else bytes([0xD9, len(data)])) + data


def _listening(run_dir: str) -> dict[str, Dealer]:
    """Connections to the sockets for halts: the broker's, and one of each subsystem of arms."""
    found = {}
    try:
        names = os.listdir(run_dir)
    except OSError:
        return {}
    for name in sorted(names):
        if name == "halt.sock" or (name.startswith("estop") and name.endswith(".sock")):
            try:
                found[name] = Dealer(os.path.join(run_dir, name))
            except OSError:  # without a listener
                continue
    return found
