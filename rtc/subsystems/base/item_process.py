"""The process that measures the report items of installed packages: their code does not run in that of the arms.

`ItemProcess` is its parent's end. `measure` never waits longer than ANSWER_S: what takes longer, or ends its process,
is "not measured". A process that ends, or that is silent for SILENT_S, begins anew.

Protocol: a SEQPACKET socket. A request is [number, item, snapshot], the answer [number, value]; answer 0 says that the
packages are loaded.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
from typing import Any

import msgspec

from rtc.plugins import registry
from rtc.runtime import time_limit
from rtc.runtime.memory_guard import limit_data
from rtc.runtime.process import die_with_parent, log_to_stderr, now_s
from rtc.runtime.process_table import in_words
from rtc.subsystems.base.report_items import ArmSnapshot, measured, not_measured

ANSWER_S = 0.02  # an idle machine answers within 0.2 ms; no arm is served meanwhile
SILENT_S = 3.0
START_S = 60.0  # limit for the packages to be loaded
MOST_BYTES = 1 << 17  # of a request or answer


class ItemProcess:
    """Made by the main thread of the process of the arms, if a package adds items."""

    def __init__(self) -> None:
        self._begin()
        self._wait(START_S)

    def _begin(self) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._ours.setblocking(False)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __spec__.name, str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what a package prints goes to the log
            )
        self._number = self._answered = 0
        self._loaded, self._asked_s, self._asked = False, now_s(), "its package, which is being loaded,"

    def measure(self, name: str, state: ArmSnapshot) -> Any:
        """The value of an item, or words that say why there is none."""
        if (status := self._process.poll()) is not None:
            self._begin_anew()
            return not_measured(f"{self._asked} has ended its process, which {in_words(status)}; it begins again")
        if not self._wait(0.0):
            if (silent_s := now_s() - self._asked_s) > (SILENT_S if self._loaded else START_S):
                self._begin_anew()
                return not_measured(f"{self._asked} has not answered for {silent_s:.1f} s; its process begins again")
            return not_measured(f"{self._asked} has not answered yet")
        self._number += 1
        self._asked, self._asked_s = name, now_s()
        try:
            self._ours.send(msgspec.msgpack.encode([self._number, name, state]))
        except OSError as error:
            return not_measured(f"its process cannot be asked: {error}")
        answer = self._wait(ANSWER_S)
        if answer is None:
            return not_measured(f"{name} has not answered within {ANSWER_S * 1000:.0f} ms")
        return answer[1]

    def _wait(self, for_s: float) -> list[Any] | None:
        """Read answers, until there is one to the latest request; None: there is none yet. Answers of before count for
        nothing."""
        answer: list[Any] | None = [self._number, None] if self._loaded and self._answered == self._number else None
        limit_s = now_s() + for_s
        while answer is None and select.select([self._ours], [], [], max(0.0, limit_s - now_s()))[0]:
            try:
                found = msgspec.msgpack.decode(self._ours.recv(MOST_BYTES), type=list)
            except (OSError, msgspec.MsgspecError):
                return None
            self._loaded, self._answered = True, found[0]
            answer = found if found[0] == self._number else None
        return answer

    def _begin_anew(self) -> None:
        asked = self._asked
        self.close()
        self._begin()
        self._asked = asked

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._process.kill()
        self._process.wait()
        self._ours.close()


def main() -> None:
    fd, parent = map(int, sys.argv[1:])
    die_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # so that a KeyboardInterrupt is one of the package
    log_to_stderr()
    limit_data()
    time_limit.install()
    with socket.socket(fileno=fd) as line:
        registry.loaded(registry.REPORT_ITEMS)
        line.send(msgspec.msgpack.encode([0, None]))
        decode = msgspec.msgpack.Decoder(tuple[int, str, ArmSnapshot]).decode
        while request := line.recv(MOST_BYTES):
            number, name, state = decode(request)
            line.send(msgspec.msgpack.encode([number, measured(name, state)]))


if __name__ == "__main__":
    main()
