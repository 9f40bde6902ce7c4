"""Question on a terminal whether a step of more than a minute may continue; without an answer it continues.

The step runs meanwhile. So a thread of its own waits for the answer, and halts by the client's halt line, which any
thread may use.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable

from rtc.protocol.messages import ProgressNote
from rtc.wording.measured import duration

LONG_S = 60.0  # a step that takes longer is worth a question
LOOK_S = 0.2  # period in which the thread checks that its answer is still needed
NO = ("n", "h")  # first letters of an answer that halts


class LongSteps:
    """`show` prints a line; `halt` stops one command; `stdin` is the descriptor of the answers."""

    def __init__(self, show: Callable[[str], None], halt: Callable[[str], None], stdin: int) -> None:
        self._show, self._halt, self._stdin = show, halt, stdin
        self._asked = ""  # the command of the open question
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def take(self, note: ProgressNote) -> None:
        """Ask if this note begins a long step; one question per command at a time."""
        if note.expected_s <= LONG_S or self._asked:
            if note.command == self._asked and note.phase.value in ("analyzing", "ended", "halting"):
                self.drop()
            return
        self._asked = note.command
        self._show(f"{note.command}: this step takes about {duration(note.expected_s)}: go on? [Y/n]  (n halts it)")
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
