"""rtc break, rtc step: pause commands before chosen steps of their scripts, and perform one step at a time (R101)."""

from __future__ import annotations

import re
from contextlib import nullcontext
from typing import Annotated

import typer

from rtc.apps.cli.cluster_cell import cell_file
from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json
from rtc.apps.cli.trace import last_number, number
from rtc.client.client import Client
from rtc.language.dictionary import verbs
from rtc.model.cells.cell import Cell
from rtc.programs.loader import decode
from rtc.programs.schema import ElaboratorProgram
from rtc.programs.splice import spliced
from rtc.protocol.messages import Breakpoint

PLACE = re.compile(r"([A-Z-]+):([1-9][0-9]{0,3})", re.IGNORECASE)


def break_(
    places: Annotated[
        list[str] | None, typer.Argument(help="VERB:STEP, such as GRASP:5. Without one the breakpoints are listed.")
    ] = None,
    clear: Annotated[bool, typer.Option("--clear", help="Remove these breakpoints; without a place, all.")] = False,
    run_dir: RunDir = None,
    key: With = None,
    json: AsJson = False,
) -> None:
    """Set breakpoints: each command of the verb pauses before that step of its script.

    The number of a step is that of `rtc trace`: "5 of 11". RESUME goes on; `rtc step` performs one step.

    Example:  rtc break GRASP:5
    Example:  rtc break --clear
    """
    named = [_checked(place) for place in places or []]
    with Client(run_dir, key=key) as rtc:
        found = [_checked(one) for one in rtc.status().get("breakpoints", [])]
        if clear:
            found = rtc.set_breakpoints([one for one in found if named and one not in named])
        elif named:
            with cell_file(rtc.cell()) if rtc.far else nullcontext(rtc.settings.cell) as name:
                notes = reachable(named, rtc.program("elaborator").body, Cell.load(name))
            found = rtc.set_breakpoints(list(dict.fromkeys([*found, *named])))
            for words in notes:
                console.print(words)
    console.print("breakpoints: " + (", ".join(map(str, found)) or "none"))
    if json:
        emit_json({"breakpoints": [str(one) for one in found]})


def _checked(place: str) -> Breakpoint:
    """Raises typer.Exit, with the reason printed, for a place without a verb of the language and a number."""
    found = PLACE.fullmatch(place)
    if found is None or found[1].upper() not in verbs():
        raise cli_error(f"{place} is not VERB:STEP, such as GRASP:5; rtc dictionary lists the verbs", 2)
    return Breakpoint(found[1].upper(), int(found[2]))


def reachable(named: list[Breakpoint], program: bytes, cell: Cell) -> list[str]:
    """What to state of breakpoints that only the steps that sense before a script may reach. Raises typer.Exit,
    with the reason printed, for one that no command can reach."""
    longest, before = longest_scripts(program), most_before(program, cell)
    notes = []
    for one in named:
        last = longest.get(one.verb, 0)
        if one.step > last + before or not last:
            words = f"no {one.verb} has a step {one.step}: its longest script has {last} steps"
            raise cli_error(f"{words}, and at most {before} that sense come before them", 2)
        if one.step > last:
            words = f"the longest script of {one.verb} has {last} steps"
            notes.append(f"{one} pauses nothing now: {words}; only looks that come first make it longer")
    return notes


def most_before(program: bytes, cell: Cell) -> int:
    """The most steps that can come before those of a script: each arm, object and seat of the cell is sensed once."""
    document = decode(program, ElaboratorProgram)
    sensing = {piece.skill: len(piece.steps) for piece in document.pieces}
    most = max((sensing[name] for name in document.senses.values()), default=0)
    return most * (len(cell.arms) * len(document.senses) + len(cell.objects) + len(cell.seats))


def longest_scripts(program: bytes) -> dict[str, int]:
    """The most steps of a script of each verb, in a program of the elaborators."""
    document = spliced(decode(program, ElaboratorProgram))
    steps = {script.script: len(script.steps) for script in document.scripts}
    found: dict[str, int] = {}
    for row in document.decision_tree:
        found[row.verb] = max(found.get(row.verb, 0), steps[row.script])
    return found


def step(
    command: Annotated[str, typer.Argument(help="Number of a paused command.", show_default="the last one")] = "",
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Let a paused command perform one step, and pause again. RESUME lets it go on to its end.

    Example:  rtc step C-7
    """
    with Client(run_dir, key=key) as rtc:
        name = number(command) if command else last_number(rtc)
        rtc.step(name)
        record = rtc.trace(name)
    console.print(f"{name} performs a step: {record.notes[-1].step}")
