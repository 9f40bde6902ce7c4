"""rtc log: lists the commands, newest last, with their outcomes."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from rtc.apps.cli.output import COLOUR, AsJson, RunDir, With, console, emit_json, table
from rtc.apps.cli.trace import Previous, print_run, run_as_json
from rtc.client.client import Client
from rtc.client.past_runs import Past, clock_time, runs
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, RequestDeclined
from rtc.runtime.settings import default_run_dir
from rtc.wording.commands import report_lines
from rtc.wording.measured import seconds
from rtc.wording.sentences import quoted

MAX_COMMANDS = 1000


def log(
    last: Annotated[
        int, typer.Option("-n", "--last", min=1, max=MAX_COMMANDS, help="Number of commands, the newest.")
    ] = 20,
    previous: Previous = False,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """The last commands: number, time of submission, duration, outcome, sentence.

    After `rtc down` it reads the journal of the run that has ended. A halt by `rtc halt` is not a command.

    Example:  rtc log -n 5
    """
    records, run = records_of(last, previous, run_dir, key)
    far = key is not None
    if json:
        emit_json({"commands": [as_row(record, run, far=far) for record in records], **run_as_json(run)})
    else:
        print_log(records, run, far=far)


def print_log(records: list[m.CommandRecord], run: Past | None, *, far: bool = False) -> None:
    print_run(run)
    if not records:
        console.print("there is no command yet")
        return
    out = table("command", "at", "took>", "outcome", "sentence")
    for record in records:
        row = as_row(record, run, far=far)
        at = row["at"] and clock_time(datetime.fromisoformat(row["at"]).timestamp())
        outcome = Text(row["outcome"], style=COLOUR[record.outcome.kind] if record.outcome else "cyan")
        reports = f"  ({row['reports']} report{'s' * (row['reports'] != 1)})" if row["reports"] else ""
        sentence = Text(quoted(record.text)).append(reports, style="dim")
        out.add_row(record.command, at or "-", seconds(row["took_s"]), outcome, sentence)
    console.print(out)
    for record in records:
        if record.reports:
            words = report_lines(record.reports[-1])
            console.print(Text(f"{record.command}  latest report: {'; '.join(words)}"))


def records_of(
    last: int, previous: bool, run_dir: Path | None, key: Path | None
) -> tuple[list[m.CommandRecord], Past | None]:
    where = run_dir or default_run_dir()
    if not previous:
        try:
            with Client(run_dir, key=key) as rtc:
                return from_cluster(rtc, last), None
        except NoCluster:
            if key or not list(runs(where)):
                raise
    ended = [past for past in runs(where) if not previous or past.journal.parent != where]
    return (ended[0].last(last), ended[0]) if ended else ([], None)


def from_cluster(rtc: Client, last: int) -> list[m.CommandRecord]:
    newest = rtc.status().commands_accepted
    records = []
    for number in range(max(1, newest - last + 1), newest + 1):
        try:
            records.append(rtc.trace(f"C-{number}"))
        except RequestDeclined:
            continue  # its record was deleted because of its age
    return records


def as_row(record: m.CommandRecord, run: Past | None, *, far: bool = False) -> dict[str, Any]:
    """A command for --json. `at` is local ISO time, or null if unknown.

    It is unknown for a `far` cluster, which has another clock, and for a run before the last boot.
    """
    boot = time.time() - time.monotonic()
    at = run.wall_s(record.accepted_at_s) if run else None if far else boot + record.accepted_at_s
    now = time.monotonic() if run is None and not far else record.notes[-1].at_s if record.notes else 0.0
    until_s = record.ended_at_s if record.ended_at_s is not None else now
    return {
        "command": record.command,
        "text": record.text,
        "source": record.source,
        "at": None if at is None else datetime.fromtimestamp(at).astimezone().isoformat(timespec="milliseconds"),
        "took_s": round(max(0.0, until_s - record.accepted_at_s), 6),
        "outcome": record.outcome.kind.value if record.outcome else record.phase.value,
        "message": record.outcome.message if record.outcome else "",
        "reports": record.reports_older + len(record.reports),
    }
