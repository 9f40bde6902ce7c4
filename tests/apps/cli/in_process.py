"""The command line in this process: a call of `rtc` without the start of Python and its imports, which take longer."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from unittest import mock

from rtc.apps.cli.main import main


def call(*words: str) -> subprocess.CompletedProcess[str]:
    """As `subprocess.run(["rtc", *words])` without a terminal. Not for `up`, which replaces the process."""
    assert words[0] != "up"
    status, output, errors = 0, io.StringIO(), io.StringIO()
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    with (
        mock.patch.object(sys, "argv", ["rtc", *words]),
        mock.patch.object(sys, "stdin", open(os.devnull)),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
    ):
        try:
            main()
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        finally:
            with contextlib.suppress(PermissionError):
                os.setpriority(os.PRIO_PROCESS, 0, niceness)  # `rtc look` raises its own
    return subprocess.CompletedProcess(["rtc", *words], status, output.getvalue(), errors.getvalue())
