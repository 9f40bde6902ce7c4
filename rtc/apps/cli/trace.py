"""rtc trace, rtc why: the record of a command as a list of phases, and as a chain of causes in words."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.output import COLOUR, AsJson, RunDir, With, cli_error, console, emit_json
from rtc.client.client import Client
from rtc.client.past_runs import Past, runs
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, RequestDeclined
from rtc.runtime.settings import default_run_dir
from rtc.wording import notes as wording
from rtc.wording.commands import address, chain, report_lines, trace_lines, waits_for
from rtc.wording.feedback import stages
from rtc.wording.measured import in_words, seconds
from rtc.wording.outcomes import trims_in_words
from rtc.wording.refusals import refusal_lines
from rtc.wording.sentences import quoted

#: the case of a command (R68, R76), in words
CASES = {
    1: "an action, fully specified",
    2: "an action; its path or arm was chosen before the start",
    3: "a skill: a fixed sequence, with figures that are measured on the way",
    4: "a skill: its sequence may change on the way",
}

NUMBER = re.compile(r"(?:C-)?(\d{1,17})", re.ASCII | re.IGNORECASE)

Command = Annotated[
    str, typer.Argument(help="Number of a command, live or ended: C-7 or 7.", show_default="the last one")
]
Previous = Annotated[bool, typer.Option("--previous", help="Use the run before the one in the run directory.")]


def trace(
    command: Command = "", previous: Previous = False, json: AsJson = False, run_dir: RunDir = None, key: With = None
) -> None:
    """Show every phase of a command: time, process (with its cube address), duration, result.

    Without a number it shows the last command. After `rtc down` it reads the journal of the run that has ended.

    Example:  rtc trace C-7
    """
    record, run = recall(command, previous, run_dir, key)
    if json:
        emit_json({**as_json(record), **run_as_json(run)})
    else:
        print_run(run)
        print_trace(record)


def recall(command: str, previous: bool, run_dir: Path | None, key: Path | None) -> tuple[m.CommandRecord, Past | None]:
    """The record of a command, and the run it belongs to if that has ended. `command` "" is the last one.

    Raises NoCluster if there is neither a cluster nor a journal, and typer.Exit, with the reason printed, if there is
    no such command.
    """
    name = number(command) if command else ""
    where = run_dir or default_run_dir()
    if previous:
        return _from_past(name, _before(where))
    try:
        with Client(run_dir, key=key) as rtc:
            name = name or last_number(rtc)
            if name:
                return rtc.trace(name), None
    except RequestDeclined as declined:
        if key or not any(past.command(_n(name)) for past in _before(where)):
            raise
        raise cli_error(f"{declined.refusal.message}; an earlier run had one: add --previous", 2) from None
    except NoCluster:
        if key or not (ended := list(runs(where))):
            raise
        return _from_past(name, ended[:1])
    return _from_past("", [] if key else _before(where))


def _before(run_dir: Path) -> list[Past]:
    """The runs before the one with its journal in the run directory itself."""
    return [past for past in runs(run_dir) if past.journal.parent != run_dir]


def _n(name: str) -> int:
    return int(name.removeprefix("C-"))


def last_number(rtc: Client) -> str:
    """The number of the newest command of a cluster; empty if there is none."""
    accepted = rtc.status().commands_accepted
    return f"C-{accepted}" if accepted else ""


def _from_past(name: str, ended: list[Past]) -> tuple[m.CommandRecord, Past]:
    for past in ended:
        found = past.command(_n(name)) if name else next(iter(past.last(1)), None)
        if found is not None:
            return found, past
    if not ended:
        raise cli_error("there is no command yet; rtc log lists them, rtc do gives one", 2)
    raise cli_error(f"there is no command {name} in the run that ended; rtc log lists its commands", 2)


def print_run(run: Past | None) -> None:
    if run is not None:
        console.print(Text(run.title, style="dim"))


def run_as_json(run: Past | None) -> dict[str, Any]:
    return {} if run is None else {"run_ended_at": run.ended_at}


def number(command: str) -> str:
    """C-7 for C-7, c-7 or 7. Raises typer.Exit, with the reason printed, for anything else."""
    if (found := NUMBER.fullmatch(command.strip())) is None:
        raise cli_error(f"{quoted(command)!r} is not the number of a command, such as C-7 or 7; rtc log lists them", 2)
    return f"C-{int(found[1])}"


def print_trace(record: m.CommandRecord) -> None:
    """Print lines, not a table, because a phase's result may be long. The phases of a step follow its name."""
    console.print(
        Text(f"{record.command}  {quoted(record.text)}  ", style="bold") + Text(f"({record.source})", style="dim")
    )
    if record.case:
        console.print(f"case {record.case}: {CASES[record.case]}", style="dim")
    console.print(Text(f"{'since':>9}  {'took':>8}  {'done by':<13} {'at':<4} now", style="bold"))
    step, node = "", ""
    for note in record.notes:
        if note.node and note.node == node and not wording.in_words(note):
            continue  # repeats the process
        node = note.node
        if note.step and note.step != step and note.phase != m.Phase.ENDED:
            step = note.step
            console.print(Text(step, style="cyan"))
        for line in trace_lines(note, record.accepted_at_s):
            console.print(Text(line))
    print_reports(record)
    _print_decision(record, details=True)


def print_reports(record: m.CommandRecord) -> None:
    """The latest reports of EVERY and WHEN, which the running broker keeps."""
    if record.reports_older:
        console.print(Text(f"reports: {record.reports_older} older ones are no longer kept", style="dim"))
    for note in record.reports:
        words = report_lines(note)
        console.print(Text(f"{seconds(note.at_s - record.accepted_at_s):>9}  reported: {'; '.join(words)}"))


def why(
    command: Command = "", previous: Previous = False, json: AsJson = False, run_dir: RunDir = None, key: With = None
) -> None:
    """Show the chain of causes: sentence -> script line -> primitive -> report -> decision, and what would clear it.

    Without a number it shows the last command. After `rtc down` it reads the journal of the run that has ended.

    Example:  rtc why
    Example:  rtc why C-7
    """
    record, run = recall(command, previous, run_dir, key)
    waits: list[str] = []
    if run is None and record.phase in (m.Phase.HELD, m.Phase.WAITING):
        with Client(run_dir, key=key) as rtc:
            waits = waits_for(rtc.status(), record)
    if json:
        outcome = as_json(record)["outcome"]
        found = {"command": record.command, "chain": chain(record), "outcome": outcome, "waits_for": waits}
        emit_json({**found, **run_as_json(run)})
    else:
        print_run(run)
        print_why(record)
        for line in waits:
            console.print(Text("    " + line))


def print_why(record: m.CommandRecord) -> None:
    for line in chain(record):
        console.print(Text(line))
    _print_decision(record, details=False)


def as_json(record: m.CommandRecord) -> dict[str, Any]:
    """The record, its notes with times since acceptance and addresses."""
    shown: dict[str, Any] = msgspec.to_builtins(record)
    shown.setdefault("outcome", None)
    for note, source in zip(shown.get("notes", []), record.notes, strict=True):
        note["since_accept_s"] = round(source.at_s - record.accepted_at_s, 6)
        note["address"] = address(source.node)
        note["words"] = wording.in_words(source)
        note["stages"] = dict(stages(source))
    return shown


def _print_decision(record: m.CommandRecord, *, details: bool) -> None:
    """`details`: also places in programs, and figures of planning."""
    outcome = record.outcome
    if outcome is None:
        console.print(Text(f"now: {record.phase.value}", style="bold"))
        return
    assert record.ended_at_s is not None
    line = Text("decision: ", style="bold").append(outcome.kind.value.upper().replace("_", " "), COLOUR[outcome.kind])
    line.append(f" after {seconds(record.ended_at_s - record.accepted_at_s)}")
    line.append(f": {outcome.message}" if outcome.message else "")
    console.print(line)
    for text in in_words(outcome.measured) if outcome.measured else ():
        console.print(Text("    " + text))
    for text in trims_in_words(outcome):
        console.print(Text("    " + text))
    if outcome.refusal is not None:
        for text in refusal_lines(outcome.refusal, record.text, details=details):
            if text != outcome.message:
                console.print(Text("    " + text))
