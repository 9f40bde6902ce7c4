"""The line of `rtc --version`. It imports no command and no library of the command line."""

from __future__ import annotations

import sys

from rtc import __version__
from rtc.model.robot import collision_checks, compiled


def line() -> str:
    python = sys.version.partition(" ")[0]
    return f"rtc {__version__} (Python {python}; collision checks: {collision_checks(compiled())})"
