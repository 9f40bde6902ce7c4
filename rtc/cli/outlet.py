"""Stdout and stderr as our commands have them: one that is full, closed or read by nobody any more is told of once.

Rich and typer each make an exit status of their own out of a reader that has gone, and neither expects a full disk: so
what is raised here is no OSError, and whoever knows what the command was doing can say what becomes of it.
"""

from __future__ import annotations

import os
import sys
from typing import Any, TextIO, cast


class Unheard(Exception):
    """What is printed on stdout reaches nobody. Raised for the first that does not; the rest is dropped in silence."""

    def __init__(self, cause: OSError | None) -> None:
        self.reader_gone = isinstance(cause, BrokenPipeError)  # `| head`: it has all that it wanted
        why = "stdout is closed" if cause is None else cause.strerror or str(cause)
        super().__init__("nobody reads on" if self.reader_gone else f"cannot print: {why}")


class Outlet:
    """A stream for text. `stream` None: it was closed before we began. Not `needed`: nobody is told when it is lost."""

    def __init__(self, stream: TextIO | None, *, needed: bool = True) -> None:
        self._needed = needed
        self._closed = stream is None
        self._lost = False
        self._stream = stream or _nowhere("w")

    def write(self, text: str) -> int:
        if self._closed and text:
            self._lose(None)
        if not self._lost:
            try:
                return self._stream.write(text)
            except OSError as error:
                self._lose(error)
        return len(text)

    def flush(self) -> None:
        if not self._lost:
            try:
                self._stream.flush()
            except OSError as error:
                self._lose(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, cause: OSError | None) -> None:
        told, self._lost, self._closed = self._lost, True, False
        with open(os.devnull, "w") as nowhere:  # what is still in the buffer goes there when Python ends
            os.dup2(nowhere.fileno(), self._stream.fileno())
        if self._needed and not told:
            raise Unheard(cause)


def attach() -> None:
    """From here on stdin, stdout and stderr are there, whatever we were started with."""
    sys.stdin = sys.stdin or _nowhere("r")
    sys.stdout = cast(TextIO, Outlet(sys.stdout))
    sys.stderr = cast(TextIO, Outlet(sys.stderr, needed=False))


def _nowhere(mode: str) -> TextIO:
    """It takes the number of the stream that is missing, before a socket does, also for whom we become (`rtc up`)."""
    number = os.open(os.devnull, os.O_RDWR)
    os.set_inheritable(number, True)
    return cast(TextIO, os.fdopen(number, mode))
