"""Pages that flood the gateway of a console, and a page that halts meanwhile.

    python -m tests.apps.console.flood BASE COOKIE KIND

floods from four sockets until it is ended. It reads no answer, except to halts.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

ROOT = Path(__file__).parents[3]  # what imports this package
SOCKETS = 4
BATCH = 100  # frames of one send
LIMIT_S = 30.0
TEXT, PING = 1, 9
#: kind -> path, opcode of its frames, and their texts in turn
KINDS: dict[str, tuple[str, int, list[str]]] = {
    "clock": ("/poses", TEXT, ["clock 1"]),
    "acknowledgement": ("/poses", TEXT, ["ack"]),
    "since": ("/story", TEXT, ['{"since": 0}']),
    "operate": ("/operate", TEXT, ['{"arm": "RIGHT-ARM", "primitive": "x", "seen_at_s": 1}']),
    "ping of a halt line": ("/halt", TEXT, ['{"ping": 1}']),
    "control frame": ("/halt", PING, [""]),
    "halt of all": ("/halt", TEXT, ['{"id": 1, "scope": "ALL"}']),
    "halt of a command": ("/halt", TEXT, [f'{{"id": {n}, "scope": "C-{n}"}}' for n in range(900, 999)]),
}


class Pages:
    """The address of a gateway and an admitted cookie."""

    def __init__(self, base: str, cookie: str) -> None:
        self.base, self.cookie = base, cookie

    @staticmethod
    def admitted(link: str) -> Pages:
        """By the link that `rtc console` prints."""
        base, _, token = link.partition("/#")
        given = Request(f"{base}/session", json.dumps({"token": token}).encode(), {"Origin": base})
        with urlopen(given, timeout=LIMIT_S) as answer:
            return Pages(base, answer.headers["set-cookie"].partition(";")[0])

    def socket(self, path: str) -> socket.socket:
        """A WebSocket after its handshake."""
        host = self.base.removeprefix("http://")
        name, _, port = host.partition(":")
        made = socket.create_connection((name, int(port)), timeout=LIMIT_S)
        made.sendall(
            f"GET {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: {self.base}\r\nCookie: {self.cookie}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += made.recv(1)
        assert head.startswith(b"HTTP/1.1 101"), head
        return made


def frame(text: str, opcode: int = TEXT) -> bytes:
    """A client's frame of at most 125 bytes, masked by zeros."""
    return bytes([0x80 | opcode, 0x80 | len(text), 0, 0, 0, 0]) + text.encode()


class HaltingPage:
    """A page with an open halt line."""

    def __init__(self, pages: Pages) -> None:
        self._socket, self._numbers, self._unread = pages.socket("/halt"), itertools.count(1), b""

    def halt(self, scope: str = "ALL") -> tuple[float, Any]:
        """Time to the answer (s), and the result. Raises TimeoutError without one."""
        number, sent_s = next(self._numbers), time.monotonic()
        self.send(json.dumps({"id": number, "scope": scope}))
        while (answer := self.answer()).get("id") != number:
            pass
        return time.monotonic() - sent_s, answer["result"]

    def send(self, *texts: str) -> None:
        self._socket.sendall(b"".join(map(frame, texts)))

    def answer(self) -> Any:
        """The next text of the gateway. Raises AssertionError when the socket is closed."""
        opcode, size = self._take(2)
        text = self._take(int.from_bytes(self._take(2), "big") if size == 126 else size)
        assert opcode & 15 == TEXT, "the halt line is closed"
        return json.loads(text)

    def close(self) -> None:
        self._socket.close()

    def _take(self, count: int) -> bytes:
        while len(self._unread) < count:
            more = self._socket.recv(1 << 16)
            assert more, "the halt line is closed"
            self._unread += more
        taken, self._unread = self._unread[:count], self._unread[count:]
        return taken


@contextlib.contextmanager
def flood(pages: Pages, kind: str) -> Iterator[None]:
    """A process that floods, until the block ends."""
    command = [sys.executable, "-m", "tests.apps.console.flood", pages.base, pages.cookie, kind]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"floods\n"
        try:
            yield
        finally:
            process.kill()


@contextlib.contextmanager
def undelayed() -> Iterator[None]:
    """The calling thread does not wait behind busy processes, if that is permitted: the gateway is judged here."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except OSError:
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _flood(made: socket.socket, batch: bytes) -> None:
    made.settimeout(None)
    with contextlib.suppress(OSError):
        while True:
            made.sendall(batch)


def main() -> None:
    base, cookie, kind = sys.argv[1:]
    path, opcode, texts = KINDS[kind]
    batch = b"".join(frame(text, opcode) for text in itertools.islice(itertools.cycle(texts), BATCH))
    sockets = [Pages(base, cookie).socket(path) for _ in range(SOCKETS)]
    threads = [threading.Thread(target=_flood, args=(made, batch), daemon=True) for made in sockets]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    print("floods", flush=True)
    for thread in threads:
        thread.join()
    time.sleep(LIMIT_S)  # its sockets are closed; the page that halts goes on


if __name__ == "__main__":
    main()
