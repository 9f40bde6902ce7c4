"""rtc load, outcomes: the workers' programs, in a running cluster and on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.cli.output import AsJson, RunDir, With, console, emit_json, table, trouble
from rtc.client import Client
from rtc.messages import WorkerKind
from rtc.outcomes import ProgramError
from rtc.program import default
from rtc.program_outcomes import outcomes as rows_of

KINDS = ", ".join(kind.value for kind in WorkerKind)


def load(
    file: Annotated[Path, typer.Argument(help="A program file (YAML; for the parser a grammar).")],
    into: Annotated[str, typer.Argument(help="The word INTO.", metavar="INTO")],
    kind: Annotated[str, typer.Argument(help=f"A kind of worker: {KINDS}.")],
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Change a program while the cluster runs; motions are not touched, and a program that fails is rolled back.

    Example:  rtc load my-grasp.yaml INTO elaborator
    """
    if into.upper() != "INTO":
        raise trouble(f"say: rtc load {file} INTO KIND, where KIND is one of {KINDS}", 2)
    if kind.lower() not in list(WorkerKind):
        raise trouble(f"{kind} is no kind of worker; one of {KINDS} is", 2)
    if not file.is_file():
        raise trouble(f"there is no file {file}", 2)
    with Client(run_dir, key=key) as rtc:
        loaded = rtc.load(kind, file)
    if json:
        told = {"kind": loaded.kind.value, "digest": loaded.digest, "file": file.name, "changes": loaded.changes}
        emit_json(told)
        return
    console.print(Text(f"{file.name} is in the {loaded.kind.value}s' program, which is now {loaded.digest}"))
    for change in loaded.changes or ["nothing has changed: all of it was there"]:
        console.print(Text(f"  {change}"))


def outcomes(
    script: Annotated[str, typer.Argument(help="A script: grasp-centering.")],
    json: AsJson = False,
) -> None:
    """Every way that every step of a script can end, and what follows. No cluster needed: the programs as they come.

    Example:  rtc outcomes grasp-centering
    """
    programs = default(WorkerKind.ELABORATOR), default(WorkerKind.BINDER), default(WorkerKind.ANALYZER)
    try:
        rows = rows_of(*programs, script.lower())
    except ProgramError as error:
        raise trouble(str(error), 2) from None
    if json:
        emit_json({"script": script.lower(), "rows": [row._asdict() for row in rows]})
        return
    out, step = table("step", "stop reason", "response"), ""
    for row in rows:
        out.add_row("" if row.step == step else row.step, row.reason.value, row.response)
        step = row.step
    console.print(out)
