"""Question on a terminal whether a step of more than a minute may continue; without an answer it continues.

The step runs meanwhile, so the question is watched by a thread of its own, which halts by the client's halt line: that
one may be used from any thread.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable

from rtc.cli.measured import duration
from rtc.protocol.messages import ProgressNote

LONG_S = 60.0  # of a step: from here on it is worth a question
LOOK_S = 0.2  # how soon the thread sees that nobody needs its answer any more
NO = ("n", "h")  # how an answer that halts begins


class LongSteps:
    """`say` prints a line; `halt` stops one command; `stdin` is the descriptor that the answer is read from."""

    def __init__(self, say: Callable[[str], None], halt: Callable[[str], None], stdin: int) -> None:
        self._say, self._halt, self._stdin = say, halt, stdin
        self._asked = ""  # the command that the open question is about
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def heard(self, note: ProgressNote) -> None:
        """Ask, once for a command at a time, when this note begins a long step."""
        if note.expected_s <= LONG_S or self._asked:
            if note.command == self._asked and note.phase.value in ("analyzing", "ended", "halting"):
                self.drop()
            return
        self._asked = note.command
        self._say(f"{note.command}: this step takes about {duration(note.expected_s)}: go on? [Y/n]  (n halts it)")
        self._over.clear()
        self._thread = threading.Thread(target=self._listen, args=(note.command,), daemon=True)
        self._thread.start()

    def drop(self) -> None:
        """Withdraw the question: it is obsolete, or another reader needs the terminal."""
        self._over.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(2 * LOOK_S)
        self._thread, self._asked = None, ""

    def _listen(self, command: str) -> None:
        while not self._over.is_set():
            if select.select([self._stdin], [], [], LOOK_S)[0]:
                answer = os.read(self._stdin, 200).decode(errors="replace").strip().lower()
                if answer.startswith(NO):
                    self._halt(command)
                return
