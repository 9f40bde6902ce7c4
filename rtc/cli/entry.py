"""Entry point of `rtc`: Ctrl-C during the slow imports prints one line instead of a traceback."""

from __future__ import annotations

import os
import signal
from importlib import import_module

TYPE_CHECKING = False  # see rtc/__init__.py
if TYPE_CHECKING:
    from typing import NoReturn

INTERRUPTED = 130  # exit status, as in shells


def main() -> None:
    """Import and run the command line."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # ignored, for example, for `rtc do ... &` in a script
        signal.signal(signal.SIGINT, leave)
    import_module("rtc.cli.main").main()


def leave(*_: object) -> NoReturn:
    """Handler of SIGINT until a command begins."""
    os.write(2, b"rtc: interrupted\n")
    os._exit(INTERRUPTED)  # nothing has started that would need an orderly end


def begun() -> None:
    """Called when a command begins: from then on SIGINT raises KeyboardInterrupt."""
    if signal.getsignal(signal.SIGINT) is leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


if __name__ == "__main__":
    main()
