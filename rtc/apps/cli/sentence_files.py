"""Files of sentences, one a line: without blank lines, comments (# or --), and with labels such as `C12: GRASP ...`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import NamedTuple

from rtc.apps.cli.output import cli_error

LABEL = re.compile(r"([A-Z]+)-?(\d+):\s+")


class Line(NamedTuple):
    """A sentence. `label`: C-12 of `C12:`; empty without one."""

    label: str
    text: str


def read(file: Path) -> list[Line]:
    """The sentences of a file; - is stdin. Raises typer.Exit, with the reason printed."""
    try:
        text = sys.stdin.read() if str(file) == "-" else file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise cli_error(f"cannot read {file}: {error}", 2) from None
    lines = (line.strip() for line in text.splitlines())
    return [_line(line) for line in lines if line and not line.startswith(("#", "--"))]


def _line(line: str) -> Line:
    found = LABEL.match(line)
    return Line(f"{found[1]}-{found[2]}", line[found.end() :]) if found else Line("", line)
