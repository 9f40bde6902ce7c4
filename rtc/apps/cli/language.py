"""`rtc parse`, `rtc dictionary`, `rtc grammar`: the language, without a cluster.

They are plain functions that the app registers. They only print.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from rtc.apps.cli.cluster_cell import cell_of
from rtc.apps.cli.output import RunDir
from rtc.language import dictionary as entries
from rtc.language.caret import show
from rtc.language.parse import default_grammar
from rtc.language.parse import parse as parse_sentence
from rtc.programs.loader import decode, default
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import Refusal
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.units import in_words

if TYPE_CHECKING:
    from rtc.model.cells.cell import Cell

REFUSED = 2  # exit status
# verbs that need no script of their own
BY_THE_BROKER = {"HALT", "PAUSE", "RESUME", "ABORT", "LOAD", "TEST", "TAKE", "DONE", "CANNOT"}


def parse(
    sentence: Annotated[str, typer.Argument(help="One sentence of the command language, in quotes.")],
    json: Annotated[bool, typer.Option("--json", help="Print the record or the refusal as JSON.")] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say what each MAINTAIN item means, and which camera looks.")
    ] = False,
    cell: Annotated[
        str, typer.Option("--cell", help="Name or file of the cell for --explain.", show_default="the cluster's")
    ] = "",
    run_dir: RunDir = None,
) -> None:
    """Parse a sentence and show the result, or the place of the error.

    It needs no cluster and sends nothing. Without a cluster, --explain is about the cell `swapout`. Exit status:
    0 valid, 2 not valid.

    Example: rtc parse "grasp Macs_old with Right_arm maintain speed 10 cm/s."
    Example: rtc parse "STOW LEFT-ARM MAINTAIN SPEED AND AVOID-NEIGHBORS" --explain
    """
    result = parse_sentence(default_grammar(), sentence)
    if json:
        print(msgspec.json.encode(result).decode())
    elif isinstance(result, ParsedCommand):
        print(understood(result))
        if explain:
            print("\n".join(explained(result, cell or cell_of(run_dir))))
    else:
        print(show(sentence, result), file=sys.stderr)
    if isinstance(result, Refusal):
        raise typer.Exit(REFUSED)


def dictionary(
    verb: Annotated[
        str | None,
        typer.Argument(
            help="A verb such as GRASP, or another word; without it, all verbs.", autocompletion=entries.verbs
        ),
    ] = None,
) -> None:
    """Print the dictionary entry of a verb in the paper's Figure 2 notation, or the list of verbs.

    Of another word, such as REPORT, it prints the meaning and the clauses.

    A verb marked (no script yet) is understood and refused until a script for it is loaded (rtc docs scripts). One
    marked (refused today) is understood, but no script can perform it.

    Example: rtc dictionary GRASP
    """
    if verb is None:
        for word in entries.verbs():
            mark = "refused today" if word in _elaborator().cannot else "no script yet"
            print(f"{word:<10} {entries.meanings().words[word]}" + (f"  ({mark})" if _unscripted(word) else ""))
        return
    result = entries.entry(verb)
    if isinstance(result, Refusal):
        print(show(verb, result), file=sys.stderr)
        raise typer.Exit(REFUSED)
    print(result, end="")
    verb = verb.upper()
    if verb in entries.verbs() and _unscripted(verb):
        cannot, instead = _elaborator().cannot.get(verb), _elaborator().instead.get(verb, "")
        state = f"cannot be performed: {cannot}" if cannot else "has no script yet"
        print(f"\n{verb} {state}" + (f"; instead: {instead}" if instead else ""), file=sys.stderr)


def _unscripted(verb: str) -> bool:
    """True if no default program performs this verb yet."""
    return verb not in BY_THE_BROKER and all(row.verb != verb or not row.enabled for row in _elaborator().decision_tree)


@lru_cache(maxsize=1)
def _elaborator() -> ElaboratorProgram:
    return decode(default(WorkerKind.ELABORATOR), ElaboratorProgram)


def grammar(
    stats: Annotated[bool, typer.Option("--stats", help="Count terminals, clauses and productions.")] = False,
) -> None:
    """Print the grammar of the command language, or its counts and clauses.

    Example: rtc grammar --stats
    """
    if not stats:
        print(entries.bnf(), end="")
        return
    for name, productions in entries.clauses().items():
        print(f"{name:<20} {len(productions):>2}  {entries.meanings().clauses[name]}")
    print()
    for what, count in entries.stats().items():
        print(f"{what.replace('_', ' '):<15} {count:>4}")


def explained(record: ParsedCommand, cell_name: str) -> list[str]:
    """What each MAINTAIN item of a record means in a cell, one line each."""
    from rtc.model.cells.cell import Cell  # slow, and needed here only

    cell = Cell.load(cell_name)
    program = _elaborator()
    lines = []
    for item in record.constraints:
        about = program.acts_on[item.slot].about if item.slot in program.acts_on else "every step"
        if item.slot not in program.constraints:
            lines.append(f"  MAINTAIN {item.slot}: refused today")
        elif item.name is not None or item.value is not None:
            given = item.name or in_words(item.value.value, item.value.unit)  # type: ignore[union-attr]
            lines.append(f"  MAINTAIN {item.slot}: {given}, as given; it acts on {about}")
        elif "" in program.constraints[item.slot]:
            lines.append(f"  MAINTAIN {item.slot}: it acts on {about}")
        elif (meant := cell.maintain.meaning(item.slot)) is None:
            lines.append(f"  MAINTAIN {item.slot}: refused, because cell {cell.name} gives it no meaning")
        else:
            unit, value = meant
            words = value if isinstance(value, str) else in_words(value, unit)
            lines.append(f"  MAINTAIN {item.slot}: {words}, the meaning in cell {cell.name}; it acts on {about}")
    return lines + _camera_in_words(record, cell)


def _camera_in_words(record: ParsedCommand, cell: Cell) -> list[str]:
    """Which camera performs a sentence in a cell; empty for a sentence of an arm."""
    program = _elaborator()
    scripts = {branch.script for branch in program.decision_tree if branch.verb == record.verb}
    looks = any("camera" in script.resources for script in program.scripts if script.script in scripts)
    if not looks or record.hand is not None:
        return []
    known = [camera.name for camera in cell.cameras]
    if not any(tag.body == record.object for tag in cell.tags):
        return [f"  VIA: refused, because {record.object} has no tags in cell {cell.name}"]
    if record.performer is None:
        which = "the camera that sees" if record.verb == "TRACK" else "the cameras that see"
        best = " best" if record.verb == "TRACK" else ""
        return [f"  VIA: {which} {record.object}{best}, of {', '.join(known)} in cell {cell.name}"]
    if record.performer in known:
        return [f"  VIA {record.performer}: this camera, also if it does not see {record.object}"]
    return [f"  VIA {record.performer}: refused; the cameras of cell {cell.name} are {', '.join(known)}"]


def understood(record: ParsedCommand) -> str:
    """The record as lines `field: value`, only fields of the sentence (SI units)."""
    fields = msgspec.to_builtins(record)
    lines = [f"{fields.pop('verb')} ({fields.pop('kind')})"]
    fields.pop("type", None)
    for field, value in fields.items():
        shown = value if isinstance(value, list) else [value]
        for item in shown:
            lines.append(f"  {field:<14} {_in_words(item)}")
    return "\n".join(lines)


def in_one_line(record: ParsedCommand) -> str:
    """The record in one line: `GRASP (task): hand RIGHT-ARM; object MACS-NEW`."""
    head, *fields = (" ".join(line.split()) for line in understood(record).splitlines())
    return ": ".join(filter(None, [head, "; ".join(fields)]))


def _in_words(value: object) -> str:
    if isinstance(value, dict):
        if set(value) == {"value", "unit"}:
            return f"{value['value']:g} {value['unit']}"
        return ", ".join(f"{k} {_in_words(v)}" for k, v in value.items())
    if isinstance(value, list):
        return " ".join(_in_words(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
