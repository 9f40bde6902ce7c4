"""rtc replay: repeat the recorded jobs of a command in a fresh process, and compare the bytes of the answers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, emit_json
from rtc.apps.cli.trace import Command, Previous, recall
from rtc.client.past_runs import JOURNAL
from rtc.protocol import wire
from rtc.protocol.messages import Repetition
from rtc.runtime.settings import default_run_dir

WORLD = "world.db"  # beside the journal
_read = wire.decoder(list[Repetition])


def replay(command: Command = "", previous: Previous = False, json: AsJson = False, run_dir: RunDir = None) -> None:
    """Repeat each recorded job of a command in a fresh worker process, and compare the bytes of its answer.

    Each job gets the input, program, cell and version of the world that it had. Nothing moves, nothing is written.
    The journal keeps the jobs of recent commands: at least 2,000 events. Exit status 1 if an answer differs.

    Example:  rtc replay C-7
    """
    record, past = recall(command, previous, run_dir, None)
    journal = past.journal if past else (run_dir or default_run_dir()) / JOURNAL
    found = repetitions(journal, record.command)
    if not found:
        raise cli_error(f"the journal has no job of {record.command} any more; rtc trace shows its record", 2)
    differing = [one for one in found if one.difference]
    if json:
        emit_json({"command": record.command, "jobs": found, "differing": len(differing)})
    else:
        for one in found:
            console.print(_line(one))
        console.print(f"{len(found) - len(differing)} of {len(found)} jobs of {record.command}: the same bytes")
    if differing:
        raise typer.Exit(1)


def repetitions(journal: Path, command: str) -> list[Repetition]:
    """Repeat the jobs of a command. `journal`: of its run; the world database is beside it."""
    recorded = _run("broker.persistence.recorded_jobs", str(journal), command)
    return _read(_run("workers.runtime.repeat", str(journal.with_name(WORLD)), given=recorded))


def _run(module: str, *arguments: str, given: bytes = b"") -> bytes:
    """The output of a process of ours. Raises typer.Exit, with its last line printed, if it fails."""
    ran = subprocess.run([sys.executable, "-P", "-m", module, *arguments], input=given, capture_output=True)
    if ran.returncode:
        lines = ran.stderr.decode(errors="replace").strip().splitlines()
        raise cli_error(f"the jobs cannot be repeated: {lines[-1] if lines else module}", 1)
    return ran.stdout


def _line(one: Repetition) -> Text:
    result = Text(f"DIFFERS at {one.difference}", "bold red") if one.difference else Text("same", "green")
    return Text(f"{one.job:<10} {one.kind.value:<11} ").append(result)
