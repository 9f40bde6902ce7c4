"""Standard streams of the command line: a broken stdout raises OutputClosed once, and is then ignored.

Rich and typer turn a closed pipe into exit statuses of their own, and do not expect a full disk. So the exception here
is not an OSError: the command itself reports what happens to its work.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any, TextIO, cast


class OutputClosed(Exception):
    """Stdout is closed, full or without a reader. Raised at the first failed write; later writes are dropped."""

    def __init__(self, cause: OSError | None) -> None:
        self.reader_gone = isinstance(cause, BrokenPipeError)  # as with `| head`, which is not an error
        why = "stdout is closed" if cause is None else cause.strerror or str(cause)
        super().__init__("the reader of stdout has closed it" if self.reader_gone else f"cannot print: {why}")


class OutputStream:
    """A text stream. `stream` is None if it was closed at the start. A failure raises only if `needed`."""

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
        reported, self._lost, self._closed = self._lost, True, False
        with open(os.devnull, "w") as nowhere:  # Python writes the rest of the buffer there at exit
            os.dup2(nowhere.fileno(), self._stream.fileno())
        if self._needed and not reported:
            raise OutputClosed(cause)


def attach() -> None:
    """Make sure that stdin, stdout and stderr exist, and wrap the last two. What the encoding of stdout lacks is
    printed as "?", since the command that it is about runs."""
    sys.stdin = sys.stdin or _nowhere("r")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    sys.stdout = cast(TextIO, OutputStream(sys.stdout))
    sys.stderr = cast(TextIO, OutputStream(sys.stderr, needed=False))


def _nowhere(mode: str) -> TextIO:
    """Open /dev/null on the free descriptor 0-2, so that no socket gets it; inheritable, because `rtc up` execs."""
    number = os.open(os.devnull, os.O_RDWR)
    os.set_inheritable(number, True)
    return cast(TextIO, os.fdopen(number, mode))
