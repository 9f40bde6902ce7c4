"""rtc shell. The interpreter is loaded when it is wanted."""

from __future__ import annotations

from importlib import import_module

from rtc.cli.output import RunDir, With


def shell(run_dir: RunDir = None, key: With = None) -> None:
    """An interpreter: sentences with history, completion and progress; Ctrl-C asks, twice halts.

    Example:  rtc shell
    """
    import_module("rtc.cli.interpreter").interpret(run_dir, key)
