"""SIGINT while the command line starts: one line instead of a traceback."""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False  # see rtc/__init__.py
if TYPE_CHECKING:
    from typing import NoReturn

INTERRUPTED = 130  # exit status, as in shells


def leave_at_interrupts() -> None:
    """Until a command begins. A shell that ignores SIGINT, as for `rtc do ... &` in a script, goes on doing so."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, leave)


def leave(*_: object) -> NoReturn:
    """Handler of SIGINT until a command begins."""
    os.write(2, b"rtc: interrupted\n")
    os._exit(INTERRUPTED)  # nothing has started that would need an orderly end


def raise_at_interrupts() -> None:
    """Called when a command begins: from then on SIGINT raises KeyboardInterrupt."""
    if signal.getsignal(signal.SIGINT) is leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)
