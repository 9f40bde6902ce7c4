"""The outcome table of a script for `rtc outcomes`: each stop reason of each step, and the response (R67, R84, R85).

Uses program data alone. Knows neither the world nor the arms.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from rtc.programs.compatibility import computes, misfits, row_of
from rtc.programs.loader import decode
from rtc.programs.recovery import RESERVE, RULES, SEARCH, STACK, Failure, matching, searched
from rtc.programs.schema import (
    AnalyzerProgram,
    BinderProgram,
    Bounds,
    ElaboratorProgram,
    ReserveEntry,
    ScriptFile,
    ScriptStep,
    TrimEntry,
)
from rtc.programs.splice import spliced
from rtc.protocol.messages import TrimOffer
from rtc.protocol.outcomes import OF_OPERATOR, ProgramError, StopReason
from rtc.protocol.spelling import unknown

FIRST_SKILL = 3  # cases 1 and 2 are actions, which cannot be trimmed
Entries = dict[int, TrimEntry | ReserveEntry]  # of the trimming stack and of `reserve`, by number


class OutcomeRow(NamedTuple):
    step: str  # "5 feel one side of the handle (GP1)"
    reason: StopReason
    response: str  # continue | trim 2 (grasp), restart_script | fail: failure class


def outcomes(
    elaborator_program: bytes, binder_program: bytes, analyzer_program: bytes, script: str
) -> list[OutcomeRow]:
    """One row per (step, stop reason) of a script and of its trims; `script` is its name or its verb.

    Raises ProgramError: the script does not exist, or the programs are incompatible.
    """
    elaborator = spliced(decode(elaborator_program, ElaboratorProgram))
    binder = decode(binder_program, BinderProgram)
    analyzer = decode(analyzer_program, AnalyzerProgram)
    rows = sorted((b for b in elaborator.decision_tree if b.verb == script.upper()), key=lambda b: -b.likelihood)
    names = [script.lower(), *(branch.script for branch in rows)]
    found = next((s for name in names for s in elaborator.scripts if s.script == name), None)
    if found is None:
        raise ProgramError(unknown("script", script, (s.script for s in elaborator.scripts)))
    for place, problem in misfits(elaborator, binder, analyzer):
        raise ProgramError(f"the programs are incompatible: {place}: {problem}")
    return list(rows_of(found, elaborator, binder, analyzer))


def explained(analyzer_program: bytes, rows: list[OutcomeRow]) -> dict[str, str]:
    """The message of each failure class in the rows: late -> "not done within LIMIT s"."""
    classes = decode(analyzer_program, AnalyzerProgram).classes
    used = sorted({row.response.rpartition("fail: ")[2] for row in rows if "fail: " in row.response})
    return {name: classes[name].message.format_map(_Capitals()) for name in used}


class _Capitals(dict[str, str]):
    def __missing__(self, name: str) -> str:
        return name.upper()


def rows_of(
    script: ScriptFile, elaborator: ElaboratorProgram, binder: BinderProgram, analyzer: AnalyzerProgram
) -> Iterator[OutcomeRow]:
    """The same of a script of spliced programs that are compatible."""
    pieces = {piece.skill: piece for piece in elaborator.pieces}
    done = [entry for entry in script.trimming_stack if entry.skill in pieces]
    reserve: Entries = dict(enumerate(elaborator.reserve if script.case >= FIRST_SKILL else (), RESERVE + 1))
    for n, step in enumerate(script.steps, 1):
        index, count = step.trim
        trims: Entries = {entry.n: entry for entry in done if index <= entry.n < index + count}
        yield from _step(f"{n} {_label(step)}", step, trims | reserve, binder, analyzer)
    for number, entry in {**{entry.n: entry for entry in done}, **reserve}.items():
        for n, step in enumerate(pieces[entry.skill].steps, 1):
            yield from _step(f"trim {number} ({entry.skill}), {n} {_label(step)}", step, {}, binder, analyzer)


def _label(step: ScriptStep) -> str:
    words = step.label.replace("{out}", "out")  # an adverb, not a thing
    return re.sub(r"\{(\w+)\}", r"the \1", words) or step.to or step.name


def _step(
    label: str, step: ScriptStep, trims: Entries, binder: BinderProgram, analyzer: AnalyzerProgram
) -> Iterator[OutcomeRow]:
    if computes(step, binder):
        yield OutcomeRow(label, StopReason.GOAL, "continue: nothing moves")
        return
    row = row_of(step)
    cells = analyzer.outcomes[row]
    for reason in (one for one in StopReason if one in cells or one not in OF_OPERATOR):
        yield OutcomeRow(label, reason, _response(step, reason, trims, cells, analyzer))


def _response(
    step: ScriptStep,
    reason: StopReason,
    trims: Entries,
    cells: dict[StopReason, str],
    analyzer: AnalyzerProgram,
) -> str:
    derived = analyzer.derived.get(row_of(step), {})
    if reason in step.expect:
        unless = [f"{what} counts as {other.value}" for what, other in derived.items() if what != "nothing_felt"]
        return "continue" + (f" (but {', '.join(unless)})" if unless else "")
    if reason is StopReason.GOAL and StopReason.CONTACT in step.expect and "nothing_felt" in derived:
        return f"counts as {derived['nothing_felt'].value}"
    name = cells[reason]
    failure = analyzer.classes[name]
    fitting = {n: t for n, t in trims.items() if failure.retriable and (not t.fits or reason in t.fits)}
    ways = list(dict.fromkeys(_ways(Failure(row_of(step), reason, name), fitting, analyzer)))
    return f"{' or '.join(ways)}, else fail: {name}" if ways else f"fail: {name}"


def _ways(failed: Failure, fitting: Entries, analyzer: AnalyzerProgram) -> Iterator[str]:
    """The recoveries that the trimmers of the program may choose, in words."""
    offers = {n: TrimOffer(skill=entry.skill, then=entry.then) for n, entry in fitting.items()}
    words = {n: f"trim {n} ({entry.skill}), {entry.then}" for n, entry in fitting.items()}
    for name in analyzer.trimmers:
        if name == STACK:
            yield from (words[n] for n in offers if n <= RESERVE)
        elif name == RULES:
            for rule, n in matching(analyzer, failed, offers):
                yield words[n] + "".join(f" if {_bounds(one)}" for one in rule.when)
        elif name == SEARCH:
            found = searched(analyzer.search, failed.reason, offers)
            first = "".join(f"trim {n} ({offers[n].skill}), then " for n in found[:-1])
            yield from [first + words[found[-1]]] if found else []
        else:
            yield from (f"{words[n]} (by {name})" for n in offers)


def _bounds(one: Bounds) -> str:
    least = [] if one.at_least is None else [f"{one.of} >= {one.at_least}"]
    return " and ".join(least + ([] if one.at_most is None else [f"{one.of} <= {one.at_most}"]))
