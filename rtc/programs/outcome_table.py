"""The outcome table of a script for `rtc outcomes`: each stop reason of each step, and the response (R67, R84, R85).

Uses program data alone. Knows neither the world nor the arms.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from rtc.language.alike import unknown
from rtc.programs.compatibility import misfits, row_of
from rtc.programs.loader import decode
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, ScriptFile, ScriptStep, TrimEntry
from rtc.protocol.outcomes import ProgramError, StopReason


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
    elaborator = decode(elaborator_program, ElaboratorProgram)
    binder = decode(binder_program, BinderProgram)
    analyzer = decode(analyzer_program, AnalyzerProgram)
    rows = sorted((b for b in elaborator.decision_tree if b.verb == script.upper()), key=lambda b: -b.likelihood)
    names = [script.lower(), *(branch.script for branch in rows)]
    found = next((s for name in names for s in elaborator.scripts if s.script == name), None)
    if found is None:
        raise ProgramError(unknown("script", script, (s.script for s in elaborator.scripts)))
    for place, problem in misfits(elaborator, binder, analyzer):
        raise ProgramError(f"the programs are incompatible: {place}: {problem}")
    return list(_rows(found, elaborator, binder, analyzer))


def explained(analyzer_program: bytes, rows: list[OutcomeRow]) -> dict[str, str]:
    """The message of each failure class in the rows: late -> "not done within LIMIT s"."""
    classes = decode(analyzer_program, AnalyzerProgram).classes
    used = sorted({row.response.rpartition("fail: ")[2] for row in rows if "fail: " in row.response})
    return {name: re.sub(r"\{(\w+)\}", lambda found: found[1].upper(), classes[name].message) for name in used}


def _rows(
    script: ScriptFile, elaborator: ElaboratorProgram, binder: BinderProgram, analyzer: AnalyzerProgram
) -> Iterator[OutcomeRow]:
    pieces = {piece.skill: piece for piece in elaborator.pieces}
    done = [entry for entry in script.trimming_stack if entry.skill in pieces]
    for n, step in enumerate(script.steps, 1):
        index, count = step.trim
        trims = [entry for entry in done if index <= entry.n < index + count]
        yield from _step(f"{n} {_label(step)}", step, trims, binder, analyzer)
    for entry in done:
        for n, step in enumerate(pieces[entry.skill].steps, 1):
            yield from _step(f"trim {entry.n} ({entry.skill}), {n} {_label(step)}", step, [], binder, analyzer)


def _label(step: ScriptStep) -> str:
    words = step.label.replace("{out}", "out")  # an adverb, not a thing
    return re.sub(r"\{(\w+)\}", r"the \1", words) or step.to or step.name


def _step(
    label: str, step: ScriptStep, trims: list[TrimEntry], binder: BinderProgram, analyzer: AnalyzerProgram
) -> Iterator[OutcomeRow]:
    if binder.actions[step.do] in binder.computes or binder.procedures.get(step.name) in binder.computes:
        yield OutcomeRow(label, StopReason.GOAL, "continue: nothing moves")
        return
    row = row_of(step)
    cells = analyzer.outcomes[row]
    for reason in StopReason:
        yield OutcomeRow(label, reason, _response(step, reason, trims, cells, analyzer))


def _response(
    step: ScriptStep,
    reason: StopReason,
    trims: list[TrimEntry],
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
    fitting = [t for t in trims if failure.retriable and (not t.fits or reason in t.fits)]
    if not fitting:
        return f"fail: {name}"
    return " or ".join(f"trim {t.n} ({t.skill}), {t.then}" for t in fitting) + f", else fail: {name}"
