"""Figures of a candidate: the variables of a script's expressions. Pure.

Sources in order of increasing priority: numbers of the cell, the command-object table, the hand, the object, the
sentence.
"""

from __future__ import annotations

import math

import msgspec
from msgspec.structs import replace

from rtc.model.cells import parts
from rtc.programs import attributes, expressions
from rtc.programs.schema import ElaboratorProgram, TableRow
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import Quantity
from rtc.protocol.units import SUFFIXES
from workers.elaborator.fillers import TableFigures, filled
from workers.mechanisms import each
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery
from workers.tasks import object_attributes
from workers.tasks.candidate import TaskCandidate

FIGURES = each(lambda mechanism: mechanism.figures)


def of_partner(candidate: TaskCandidate) -> TaskCandidate:
    """The same candidate as the second arm sees it: for the steps that it performs. Raises Refused."""
    assert candidate.partner is not None, "a script for two arms has two"
    limits = msgspec.structs.replace(candidate.limits, attitude=None)  # only the first hand keeps it
    return with_figures(replace(candidate, hand=candidate.partner, partner=candidate.hand, limits=limits))


def with_figures(candidate: TaskCandidate) -> TaskCandidate:
    """The candidate with all its figures; of a camera those of its sentence, and the attributes of the object. Raises
    Refused if the command-object table has no row for it, and no filler."""
    about = candidate if candidate.hand is not None else replace(candidate, thing=None, target=None)
    program, parsed, query = candidate.program, candidate.parsed, candidate.query
    arm, thing, point = about.hand, about.thing, about.point
    figures: dict[str, float] = msgspec.structs.asdict(query.cell.numbers)
    of_object = object_attributes.figures(program, query, candidate.thing)
    row = _table(program, parsed.verb, thing, query, figures | of_object)
    figures |= row.values | of_object
    if arm is not None:
        figures |= {"opening_m": arm.gripper.max_opening_m, "hand_width_m": query.hand_width(arm.name)}
        figures["max_grip_n"] = arm.gripper.max_force_n
        for figure, of_hand in program.by_hand.items():
            if figure in figures:
                figures[figure] = min(figures[figure], figures[of_hand])
    if point is not None and thing is not None:
        figures |= pose_spread.uncertainty_figures(query.spread(f"{thing.name}.frame"), point.frame.pose)
        figures["seen"] = float(query.finds(thing.name))
    for figures_of in FIGURES:
        figures |= figures_of(about)
    figures |= _figure_of("amount", parsed.amount)
    figures |= _figure_of("by", parsed.place.by if parsed.place else None)
    figures |= _figure_of("to", parsed.to_value)
    if parsed.duration_s is not None:
        figures["duration_s"] = parsed.duration_s
    return replace(candidate, figures=figures, filler=row.filler)


def _figure_of(name: str, quantity: Quantity | None) -> dict[str, float]:
    """The figure of a quantity; of a turn both in rad and in turns."""
    if quantity is None:
        return {}
    if quantity.unit in ("rad", "turn"):
        rad = quantity.value * (1.0 if quantity.unit == "rad" else math.tau)
        return {f"{name}_rad": rad, f"{name}_turns": rad / math.tau}
    return {f"{name}_{SUFFIXES[quantity.unit]}": quantity.value}


def _not_for(program: ElaboratorProgram, verb: str, thing: parts.Object | None, query: WorldQuery) -> Refused:
    """Refusal if the table has no row for this verb and object. A verb without any row is a program error."""
    rows = program.table_rows.get(verb, [])
    fits = [one.name for one in query.cell.objects if any(_is_about(row, one) for row in rows)]
    if thing is None or not rows:
        what = f"{thing.name} ({thing.kind})" if thing else "no object"
        return Refused.because(
            RefusalReason.PROGRAM,
            f"the command-object table has no row for {verb} and {what}",
            where="command_object_table",
            clears=f"load a row of command_object_table for verb {verb} (rtc docs scripts)",
        )
    return Refused.because(
        RefusalReason.NO_SCRIPT,
        f"{verb} is not possible with {thing.name}: it is a {thing.kind}",
        where=thing.name,
        expected=fits,
        clears=_other_sentence(program, verb, thing, fits),
    )


def _other_sentence(program: ElaboratorProgram, verb: str, thing: parts.Object, fits: list[str]) -> str:
    """What can be given instead: the verb with another object, or another verb with this one."""
    if fits:
        return f"{verb} is possible with {' or '.join(fits)}"
    verbs = {one for one, rows in program.table_rows.items() if any(_is_about(row, thing) for row in rows)}
    about = {one.script for one in program.scripts if "object" in one.uses}
    for branch in program.decision_tree:  # verbs without figures of an object are possible with every one
        if (
            branch.enabled
            and branch.script in about
            and not any(map(_of_object, program.table_rows.get(branch.verb, [])))
        ):
            verbs.add(branch.verb)
    return f"nothing here is for {verb}; with {thing.name} is possible: {', '.join(sorted(verbs))}"


def _table(
    program: ElaboratorProgram, verb: str, thing: parts.Object | None, query: WorldQuery, given: dict[str, float]
) -> TableFigures:
    """The row of the command-object table, evaluated over `given`: numbers of the cell, attributes of the object. One
    that is absent is asked of the fillers."""
    rows = [row for row in program.table_rows.get(verb, []) if _is_about(row, thing)]
    if not rows:
        if (row := filled(program, verb, thing, given)) is not None:
            return row
        raise _not_for(program, verb, thing, query)
    rows.sort(key=lambda row: bool(row.name))  # rows for a name override rows for a kind
    values = {name: value for row in rows for name, value in row.values.items()}
    object_attributes.refuse_unstated(program, query, thing, attributes.of_values(values.values()))
    return TableFigures({name: expressions.number(value, given) for name, value in values.items()})


def _of_object(row: TableRow) -> bool:
    return bool(row.kind or row.name)


def _is_about(row: TableRow, thing: parts.Object | None) -> bool:
    if thing is None:
        return not row.kind and not row.name
    return row.name == thing.name if row.name else row.kind == thing.kind
