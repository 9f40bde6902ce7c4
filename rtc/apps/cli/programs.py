"""rtc load, programs, outcomes: load programs of workers, go back to earlier ones, show what a step can lead to."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json, errors, table
from rtc.client.client import Client
from rtc.programs import whole_file
from rtc.programs.loader import GRAMMAR, PROGRAMS, changes, default, merge
from rtc.programs.outcome_table import explained
from rtc.programs.outcome_table import outcomes as rows_of
from rtc.programs.sandbox import CheckRequest, in_a_process
from rtc.protocol.messages import ProgramEntry, ProgramLoaded, ProgramReply, WorkerKind
from rtc.protocol.outcomes import NoCluster, ProgramError
from rtc.wording.measured import duration

KINDS = ", ".join(kind.value for kind in WorkerKind)
RESET = "the default program"  # the name of a reset in --json
DEFAULTS = "the default programs (no cluster runs)"
USAGE = f"use: rtc load FILE INTO KIND, where KIND is one of {KINDS}; FILE alone if it has a section for each kind"


def load(
    file: Annotated[Path | None, typer.Argument(help="A program file (YAML; for the parser a grammar).")] = None,
    into: Annotated[str, typer.Argument(help="The word INTO.", metavar="INTO")] = "",
    kind: Annotated[str, typer.Argument(help=f"A kind of worker: {KINDS}.")] = "",
    check: Annotated[bool, typer.Option("--check", help="Check the file; change nothing. Needs no cluster.")] = False,
    show: Annotated[bool, typer.Option("--list", help="List all programs and their changes.")] = False,
    reset: Annotated[str, typer.Option("--reset", metavar="KIND", help="Back to the default program.")] = "",
    export: Annotated[
        Path | None, typer.Option("--export", help="Copy the default programs to a new directory. Needs no cluster.")
    ] = None,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Change a program while the cluster runs. Motions continue; a program that fails is rolled back.

    A file with sections for several kinds is loaded as a whole, or not at all (rtc docs scripts).
    --check shows the errors of the file, or what it would change in the programs of the running cluster (without one,
    in the default programs). Exit status: 0 it may be loaded, 2 it may not.

    Example:  rtc load my-grasp.yaml INTO elaborator
    Example:  rtc load my-grasp.yaml INTO elaborator --check
    Example:  rtc load wipe.yaml
    Example:  rtc load --reset elaborator
    Example:  rtc load --export programs
    """
    if export is not None:
        _export(export, json)
    elif show:
        _list(json, run_dir, key)
    elif reset:
        with Client(run_dir, key=key) as rtc:
            _loaded(rtc.reset(_kind(reset)), "", json)
    elif file is None or (into and into.upper() != "INTO"):
        raise cli_error(USAGE, 2)
    elif check:
        _check(_parts(file, into, kind), file.name, json, run_dir, key)
    elif not into:
        _parts(file, into, kind)
        with Client(run_dir, key=key) as rtc:
            for one in rtc.load_sections(file):
                _loaded(one, file.name, json)
    else:
        wanted, path = _kind(kind), _readable(file)
        with Client(run_dir, key=key) as rtc:
            _loaded(rtc.load(wanted, path), path.name, json)


def _export(directory: Path, json: bool) -> None:
    """Copy the files of the default programs, one directory per kind, so that one can be changed and loaded."""
    try:
        shutil.copytree(PROGRAMS, directory, ignore=shutil.ignore_patterns("__pycache__"))
        (directory / WorkerKind.PARSER.value).mkdir()
        shutil.copy(GRAMMAR, directory / WorkerKind.PARSER.value)
    except FileExistsError:
        raise cli_error(f"{directory} exists already; name a new directory", 2) from None
    except OSError as error:
        raise cli_error(f"{directory} cannot be written: {error.strerror}", 1) from None
    files = sorted(str(path.relative_to(directory)) for path in directory.rglob("*") if path.is_file())
    if json:
        emit_json({"directory": str(directory), "files": files})
    else:
        console.print(Text(f"{len(files)} files in {directory}; change one, then: rtc load FILE INTO KIND"))


def _kind(word: str) -> WorkerKind:
    if word.lower() not in list(WorkerKind):
        raise cli_error(f"{word or 'nothing'} is not a kind of worker; one of {KINDS} is", 2)
    return WorkerKind(word.lower())


def _readable(file: Path) -> Path:
    if file.is_dir():
        raise cli_error(f"{file} is a directory; name a file", 2)
    if not file.is_file():
        raise cli_error(f"there is no file {file}", 2)
    return file


def _loaded(loaded: ProgramLoaded, name: str, json: bool) -> None:
    if json:
        diffs = {"kind": loaded.kind.value, "digest": loaded.digest, "file": name or RESET, "changes": loaded.changes}
        emit_json(diffs)
        return
    reset = f"{loaded.kind.value}: back to the default program ({loaded.digest})"
    console.print(
        Text(f"{name} is in the {loaded.kind.value}s' program, which is now {loaded.digest}" if name else reset)
    )
    for change in loaded.changes or ["nothing has changed: the program had all of it"]:
        console.print(Text(f"  {change}"))


def _programs(run_dir: Path | None, key: Path | None) -> tuple[dict[WorkerKind, bytes], str]:
    """The programs in use and their owner; without a cluster the default ones."""
    try:
        with Client(run_dir, key=key) as rtc:
            return {kind: rtc.program(kind).body for kind in WorkerKind}, f"the cluster in {rtc.where}"
    except NoCluster:
        if key is not None:
            raise
        return {kind: default(kind) for kind in WorkerKind}, DEFAULTS


def _parts(file: Path, into: str, kind: str) -> dict[WorkerKind, bytes]:
    """What the file has for each kind: all of it for the kind after INTO, else its sections."""
    body = _readable(file).read_bytes()
    if into:
        return {_kind(kind): body}
    try:
        return whole_file.sections(body, file.name)
    except ProgramError as error:
        raise cli_error(f"{error}. Or {USAGE}", 2) from None


def _check(parts: dict[WorkerKind, bytes], name: str, json: bool, run_dir: Path | None, key: Path | None) -> None:
    """Check each part against the programs in use, with the parts before it."""
    programs, whose = _programs(run_dir, key)
    for kind, body in parts.items():
        asked = CheckRequest(kind=kind, name=name, body=body, reset=False, program=programs[kind], others=programs)
        checked = in_a_process(asked)
        if checked.error:
            raise cli_error(checked.error, 2, file=name, against=whose)
        programs[kind] = checked.merged
        if json:
            emit_json({"kind": kind.value, "file": name, "against": whose, "changes": checked.changes})
            continue
        console.print(Text(f"{name} may be loaded into the {kind.value}s' program of {whose}"))
        for change in checked.changes or ["nothing would change: the program has all of it"]:
            console.print(Text(f"  {change}"))


def _list(json: bool, run_dir: Path | None, key: Path | None) -> None:
    """The differences from the default programs, kind by kind."""
    with Client(run_dir, key=key) as rtc:
        found = {kind: rtc.program(kind) for kind in WorkerKind}
        rolled_back = rtc.status().rolled_back
    diffs = {kind: changes(kind, default(kind), reply.body) for kind, reply in found.items()}
    if json:
        rows = {kind: {"digest": found[kind].digest, "changes": diffs[kind]} for kind in found}
        emit_json({"programs": rows, "rolled_back": rolled_back})
        return
    for kind, reply in found.items():
        console.print(Text(f"{kind.value:<11} {reply.digest}  {'' if diffs[kind] else 'the default program'}".rstrip()))
        for change in diffs[kind]:
            console.print(Text(f"  {change}"))
        if why := rolled_back.get(kind.value):
            errors.print(Text(f"  {why}", style="yellow"))
    if any(diffs.values()):
        console.print(Text("rtc load --reset KIND restores the default", style="dim"))


def programs(
    back: Annotated[
        str, typer.Option("--back", metavar="DIGEST", help="Use this program again; its first characters are enough.")
    ] = "",
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """The programs that each kind of worker has used, the newest first: when, from which file, what changed.

    A program is known by its digest. --back takes it into use again, as `rtc load` would; motions continue.

    Example:  rtc programs
    Example:  rtc programs --back 3f1c
    """
    with Client(run_dir, key=key) as rtc:
        found = {kind: rtc.program(kind) for kind in WorkerKind}
        if back:
            kind, entry = _earlier(found, back.lower())
            _loaded(rtc.reset(kind, entry.digest, entry.file or "default"), entry.file or "the default", json)
        else:
            _history(found, json)


def _earlier(found: dict[WorkerKind, ProgramReply], digest: str) -> tuple[WorkerKind, ProgramEntry]:
    """The program whose digest begins so."""
    entries = {one.digest: (kind, one) for kind, reply in found.items() for one in reversed(reply.history)}
    fitting = [entry for name, entry in entries.items() if name.startswith(digest)]
    if len(fitting) != 1:
        which = "several programs begin" if fitting else "no program of this cluster begins"
        raise cli_error(f"{which} with {digest}; rtc programs lists them", 2)
    return fitting[0]


def _history(found: dict[WorkerKind, ProgramReply], json: bool) -> None:
    if json:
        rows = {
            kind: {"in_use": reply.digest, "history": [msgspec.structs.asdict(one) for one in reply.history]}
            for kind, reply in found.items()
        }
        emit_json({"programs": rows})
        return
    for kind, reply in found.items():
        console.print(Text(kind.value, style="bold"))
        newest = next((n for n, one in enumerate(reply.history) if one.digest == reply.digest), None)
        for n, one in enumerate(reply.history):
            used = "in use" if n == newest else ""
            ago = f"{duration(max(1.0, round(one.age_s)))} ago"
            console.print(Text(f"  {one.digest}  {one.file or 'the default program'}, {ago}  {used}".rstrip()))
            for change in one.changes:
                console.print(Text(f"    {change}", style="dim"))
    console.print(Text("rtc programs --back DIGEST uses one again", style="dim"))


def outcomes(
    script: Annotated[str, typer.Argument(help="A script, or a verb: grasp-centering.")],
    file: Annotated[Path | None, typer.Option("--file", help="Your script file, treated as if it were loaded.")] = None,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Each possible end of each step of a script, and what follows.

    It uses the programs of the running cluster; without one, the default programs.

    Example:  rtc outcomes grasp-centering
    Example:  rtc outcomes carry --file carry.yaml
    """
    programs, _ = _programs(run_dir, key)
    elaborator = programs[WorkerKind.ELABORATOR]
    try:
        if file is not None:
            elaborator = merge(WorkerKind.ELABORATOR, elaborator, file.name, _readable(file).read_bytes(), programs)
        rows = rows_of(elaborator, programs[WorkerKind.BINDER], programs[WorkerKind.ANALYZER], script.lower())
    except ProgramError as error:
        raise cli_error(str(error), 2) from None
    if json:
        emit_json({"script": script.lower(), "rows": [row._asdict() for row in rows]})
        return
    out, step = table("step", "stop reason", "response"), ""
    for row in rows:
        out.add_row("" if row.step == step else row.step, row.reason.value, row.response)
        step = row.step
    console.print(out)
    for name, message in explained(programs[WorkerKind.ANALYZER], rows).items():
        console.print(Text(f"{name}: ", style="bold") + Text(message))
