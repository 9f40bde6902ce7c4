"""Entry point of `rtc`: Ctrl-C during the slow imports prints one line instead of a traceback."""

from __future__ import annotations

from importlib import import_module

from rtc.apps.cli.interrupts import leave_at_interrupts


def main() -> None:
    """Import and run the command line."""
    leave_at_interrupts()
    import_module("rtc.apps.cli.main").main()


if __name__ == "__main__":
    main()
