"""rtc trust: how far predictions can be trusted, from the steps of the commands so far."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from typing import Annotated, Any

import typer
from rich.text import Text

from rtc.apps.cli.log import MAX_COMMANDS, records_of
from rtc.apps.cli.output import AsJson, RunDir, With, console, emit_json, table
from rtc.apps.cli.trace import Previous, print_run, run_as_json
from rtc.protocol.messages import CommandRecord
from rtc.protocol.outcomes import Compared, Figure
from rtc.wording.feedback import shown_as

Kind = tuple[str, str]  # verb and kind of step


def trust(
    last: Annotated[
        int, typer.Option("-n", "--last", min=1, max=MAX_COMMANDS, help="Number of commands, the newest.")
    ] = MAX_COMMANDS,
    verb: Annotated[str, typer.Option(help="Only the steps of this verb.", show_default="all")] = "",
    previous: Previous = False,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Compare what was predicted of each step with what was measured, by verb and kind of step.

    Shown are the number of steps, the median and the greatest difference, and how many were outside the band of the
    prediction. A step that ended otherwise than expected counts as unexpected.

    Example:  rtc trust
    Example:  rtc trust --verb GRASP -n 50
    """
    records, run = records_of(last, previous, run_dir, key)
    kinds = {kind: steps for kind, steps in by_kind(records).items() if not verb or kind[0] == verb.upper()}
    if json:
        emit_json(
            {"commands": len(records), "steps": [as_row(kind, steps) for kind, steps in kinds.items()]}
            | run_as_json(run)
        )
        return
    print_run(run)
    if not kinds:
        console.print("no step was compared with its prediction yet")
        return
    print_rows(kinds)


def by_kind(records: Iterable[CommandRecord]) -> dict[Kind, list[Compared]]:
    """All comparisons in these records, by verb and kind of step, in the order of their names."""
    found: dict[Kind, list[Compared]] = {}
    for record in records:
        for note in record.notes:
            if (one := note.compared) is not None:
                found.setdefault((one.verb, one.kind), []).append(one)
    return dict(sorted(found.items()))


def as_row(kind: Kind, steps: list[Compared]) -> dict[str, Any]:
    """The figures of one kind of step; differences are measured minus predicted, in the unit of the figure's name."""
    figures = {name: summary(values) for name, values in figures_of(steps).items()}
    return {
        "verb": kind[0],
        "kind": kind[1],
        "steps": len(steps),
        "unexpected": sum(not step.figures for step in steps),
        "figures": figures,
    }


def figures_of(steps: Iterable[Compared]) -> dict[str, list[Figure]]:
    found: dict[str, list[Figure]] = {}
    for step in steps:
        for figure in step.figures:
            found.setdefault(figure.name, []).append(figure)
    return found


def summary(figures: list[Figure]) -> dict[str, float]:
    differences = [one.measured - one.predicted for one in figures]
    return {
        "count": len(figures),
        "predicted": statistics.median(one.predicted for one in figures),
        "median": statistics.median(differences),
        "worst": max(differences, key=abs),
        "outside": sum(one.drifts for one in figures),
    }


def print_rows(kinds: Mapping[Kind, list[Compared]]) -> None:
    out = table("step", "steps>", "unexpected>", "figure", "predicted>", "median>", "worst>", "outside>")
    for kind, steps in kinds.items():
        row = as_row(kind, steps)
        head = [" ".join(kind), str(row["steps"]), str(row["unexpected"] or "-")]
        for name, figure in row["figures"].items() or [("", None)]:
            out.add_row(*head, *_cells(name, figure))
            head = ["", "", ""]
    console.print(out)


def _cells(name: str, figure: dict[str, float] | None) -> list[Text | str]:
    if figure is None:
        return [""] * 5
    words, scale, unit = shown_as(name)
    outside = int(figure["outside"])
    return [
        words,
        f"{scale * figure['predicted']:.4g} {unit}",
        f"{scale * figure['median']:+.3g}",
        f"{scale * figure['worst']:+.3g}",
        Text(f"{outside} of {int(figure['count'])}", style="bold yellow" if outside else ""),
    ]
