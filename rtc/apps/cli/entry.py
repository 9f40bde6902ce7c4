"""Entry point of `rtc`: Ctrl-C during the slow imports prints one line instead of a traceback."""

from __future__ import annotations

import sys
from importlib import import_module

from rtc.apps.cli.interrupts import leave_at_interrupts
from rtc.runtime.environment import use_rooms


def main() -> None:
    """Run the command line: in a process of the cluster's, else in this one, once all is imported.

    A plain `rtc halt` sends its order before that."""
    leave_at_interrupts()
    if sys.argv[1:] == ["--version"]:
        print(import_module("rtc.apps.cli.version").line())
        return
    if (
        sys.argv[1:2] == ["halt"]
        and (status := import_module("rtc.apps.cli.halt_at_once").run(sys.argv[2:])) is not None
    ):
        sys.exit(status)
    use_rooms()
    if (status := import_module("rtc.apps.cli.forked").run(sys.argv[1:])) is not None:
        sys.exit(status)
    import_module("rtc.apps.cli.main").main()


if __name__ == "__main__":
    main()
