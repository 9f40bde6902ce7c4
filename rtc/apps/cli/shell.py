"""rtc shell: an interactive interpreter, loaded when the command runs."""

from __future__ import annotations

import sys
from importlib import import_module

from rtc.apps.cli.output import RunDir, With


def shell(run_dir: RunDir = None, key: With = None) -> None:
    """An interpreter: sentences with history, completion and progress; Ctrl-C asks, twice halts.

    Lines from a pipe or a file are executed one after the other, without a prompt.

    Example:  rtc shell
    Example:  rtc shell < sentences.txt
    """
    interpreter = import_module("rtc.apps.cli.interpreter")
    if sys.stdin.isatty():
        interpreter.interpret(run_dir, key)
    else:
        interpreter.obey_lines(sys.stdin, run_dir, key)
