"""rtc halt: stop motion from the shell. Its plain forms take a shorter way, `rtc.apps.cli.halt_at_once`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import zmq
from rich.console import Console
from rich.text import Text

from rtc.apps.cli.halt_at_once import NOT_CONFIRMED, TIMEOUT_S, seconds
from rtc.apps.cli.halt_words import confirmed, in_words, state_of
from rtc.apps.cli.output import AsJson, RunDir, With, console, emit_json, errors, exits_with
from rtc.apps.cli.stdio import OutputClosed
from rtc.client.halt import HALT_ENDPOINTS, HaltLine, HaltResult, SubsystemHalt, local_settings
from rtc.language.fastpath import named_scope
from rtc.protocol.outcomes import NoCluster
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import is_listening, not_running
from rtc.runtime.settings import default_run_dir

if TYPE_CHECKING:
    from rtc.client.client import Client  # its import is slow, and `rtc halt` does not need it


def halt(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCOPE", help="ALL, an arm by its name, a command (C-7), or an object; else ALL."),
    ] = None,
    timeout: Annotated[str, typer.Option(metavar="FLOAT", help="Seconds to wait for rest.")] = f"{TIMEOUT_S}",
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Stop motion now, also without a broker: it bypasses every queue. Exit status 0 only when rest is confirmed.

    The printed latency is the time from this order to the first decelerating tick of a joint. For a cluster on another
    machine it ends with the arrival of its report.

    Example:  rtc halt
    Example:  rtc halt RIGHT-ARM
    """
    scope = named_scope(" ".join(words or []))
    with _halt_line(run_dir or default_run_dir(), key) as line:
        result = line.halt(scope, timeout_s=seconds(timeout), on_rest=_show)
    code = 0 if result.confirmed else NOT_CONFIRMED
    if json:
        with exits_with(code):
            emit_json(result)
    else:
        print_halt(result)
        if not result.reached and not result.declined and "halt" in result.sent_to and result.scope.startswith("C-"):
            with suppress(OutputClosed):
                for line_of_state in state_of(result.scope, run_dir, key):
                    console.print(Text(line_of_state))
    raise typer.Exit(code)


@contextmanager
def _halt_line(run_dir: Path, key: Path | None) -> Iterator[HaltLine]:
    """A halt line. For a local cluster it needs two sockets but no files, so deleted files cannot prevent a halt.

    Raises NoCluster if no process listens.
    """
    if key is None:
        try:
            there = is_listening(run_dir, HALT_ENDPOINTS)
        except PermissionError:
            raise NoCluster(f"the cluster in {run_dir} belongs to another user; choose another --run-dir") from None
        if not there:
            raise not_running(run_dir)
        endpoints: Endpoints = local_settings(run_dir)
    else:
        endpoints = KeyFile.load(key)
    with zmq.Context() as context:
        line = HaltLine(context, endpoints)
        try:
            yield line
        finally:
            line.close()


def halt_by(rtc: Client, scope: str, out: Console = console) -> HaltResult:
    """Halt as a client, and print the result; on stderr at once what rests while others are awaited."""
    result = rtc.halt(scope, on_rest=_show)
    print_halt(result, out)
    return result


def _show(found: SubsystemHalt, awaited: list[str]) -> None:
    with suppress(OutputClosed):
        errors.print(Text.assemble(*confirmed(found, awaited)))


def print_halt(result: HaltResult, out: Console = console) -> None:
    """Print the result of a halt; on stderr if `out` is broken."""
    for line in in_words(result):
        text = Text.assemble(*line)
        try:
            out.print(text)
        except OutputClosed:
            out = errors
            out.print(text)
