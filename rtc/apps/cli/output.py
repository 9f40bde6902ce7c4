"""Output of the command line: console, exit codes, JSON line, and the layout of refusals.

It knows outcomes and refusals, but not sockets. Text from outside is never interpreted as markup.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from rtc.apps.cli.json_line import emit_json as emit_json  # most commands print with both modules
from rtc.apps.cli.stdio import OutputClosed
from rtc.language.refuse import visible
from rtc.protocol.outcomes import OutcomeKind

NO_CLUSTER = 4
LEFT_RUNNING = 130  # exit status after Ctrl-C, as in shells
EXIT = {  # of several outcomes the first in this order decides
    OutcomeKind.HALT_NOT_CONFIRMED: 3,
    OutcomeKind.HALTED: 3,
    OutcomeKind.LOST_SUBSYSTEM: 1,
    OutcomeKind.FAILED: 1,
    OutcomeKind.ABORTED: 1,
    OutcomeKind.REFUSED: 2,
    OutcomeKind.SUCCEEDED: 0,
}
COLOUR = {
    OutcomeKind.SUCCEEDED: "bold green",
    OutcomeKind.FAILED: "bold red",
    OutcomeKind.REFUSED: "bold yellow",
    OutcomeKind.ABORTED: "bold magenta",
    OutcomeKind.HALTED: "bold magenta",
    OutcomeKind.HALT_NOT_CONFIRMED: "bold white on red",
    OutcomeKind.LOST_SUBSYSTEM: "bold white on red",
}

DURATION_UNITS = {"ms": 1e-3, "s": 1.0, "m": 60.0, "": 1.0}  # seconds per unit of a duration in an option
PIPED_WIDTH = 160  # columns of a table without a terminal


class Screen(Console):
    """A console that shows control characters instead of obeying them, because names and labels come from outside."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield segment._replace(text="\n".join(map(visible, segment.text.split("\n"))))


_on_terminal = sys.stdout is not None and sys.stdout.isatty()
console = Screen(highlight=False, soft_wrap=True, width=None if _on_terminal else PIPED_WIDTH)
errors = Screen(stderr=True, highlight=False, soft_wrap=True)

RunDir = Annotated[Path | None, typer.Option("--run-dir", help="The cluster's run directory.", show_default="yours")]
With = Annotated[Path | None, typer.Option("--with", help="A key file, for a cluster on another machine.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")]


def exit_code(kinds: Iterable[OutcomeKind]) -> int:
    """0 all succeeded, 1 a failure, 2 a refusal, 3 halted; the worst of several."""
    seen = set(kinds)
    return next((code for kind, code in EXIT.items() if kind in seen), 0)


def cli_error(message: str, code: int = 1, **known: Any) -> typer.Exit:
    """Print an expected error (with --json also as JSON, with the fields `known`); raise the result of this call."""
    errors.print(Text("rtc: ", style="bold red") + Text(message))
    if "--json" in sys.argv:
        with suppress(OutputClosed):  # the error is on stderr already
            emit_json({"error": message, "exit": code, **known})
    return typer.Exit(code)


@contextmanager
def exits_with(code: int) -> Iterator[None]:
    """If stdout is broken inside the block, report that on stderr and exit with `code`."""
    try:
        yield
    except OutputClosed as closed:
        errors.print(f"rtc: {closed}")
        raise typer.Exit(code) from None


def duration_s(text: str, option: str) -> float:
    """Seconds of 2s, 500ms or 5m. Raises typer.Exit, with the reason printed, if it is not a duration."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(ms|s|m|)", text.strip())
    if found is None or not 0 < float(found[1]) < math.inf:
        raise cli_error(f"{option} is a duration such as 2s, 500ms or 5m; not {text}", 2)
    return float(found[1]) * DURATION_UNITS[found[2]]


def table(*columns: str, title: str = "") -> Table:
    made = Table(title=title or None, title_justify="left", box=None, pad_edge=False, header_style="bold")
    for column in columns:
        right = column.endswith(">")
        made.add_column(column.rstrip(">"), justify="right" if right else "left", overflow="fold")
    return made
