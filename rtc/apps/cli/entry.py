"""Entry point of `rtc`: Ctrl-C during the slow imports prints one line instead of a traceback."""

from __future__ import annotations

import sys
from importlib import import_module

from rtc.apps.cli.halt_at_once import run
from rtc.apps.cli.interrupts import leave_at_interrupts
from rtc.runtime.environment import use_rooms


def main() -> None:
    """Import and run the command line. A plain `rtc halt` sends its order before anything else is imported."""
    leave_at_interrupts()
    if sys.argv[1:] == ["--version"]:
        print(import_module("rtc.apps.cli.version").line())
        return
    if sys.argv[1:2] == ["halt"] and (status := run(sys.argv[2:])) is not None:
        sys.exit(status)
    use_rooms()
    import_module("rtc.apps.cli.main").main()


if __name__ == "__main__":
    main()
