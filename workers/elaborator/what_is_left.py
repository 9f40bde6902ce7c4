"""The sentence for what is left of a relative one, should it end before its amount: `do it again` would do all. Pure.

The elaborator writes it into the step that goes by the amount. The analyzer puts in what is left.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from rtc.programs import expressions
from rtc.programs.schema import ScriptFile, ScriptStep
from rtc.protocol.messages import Step
from workers.tasks.candidate import TaskCandidate
from workers.tasks.sentence_of import relative_amount, sentence_of

LEFT = "{left}"  # in the sentence: the amount that is left, without its sign


def noted(script: ScriptFile, steps: list[Step], candidate: TaskCandidate) -> list[Step]:
    """The steps of the script; the last one that goes by the amount of a relative sentence has that for the rest."""
    amount = relative_amount(candidate.parsed)
    if amount is None:
        return steps
    rest = sentence_of(candidate.parsed, f"-{LEFT}" if amount.value < 0.0 else LEFT)
    names = {f"{name}_{unit}" for name in ("amount", "by") for unit in ("m", "rad", "turns")}
    using = [n for n, step in enumerate(script.steps) if names & set(_figures(script, step))]
    if not rest or not using:
        return steps
    last = using[-1]
    return [*steps[:last], msgspec.structs.replace(steps[last], rest=rest), *steps[last + 1 :]]


def _figures(script: ScriptFile, step: ScriptStep) -> Iterator[str]:
    """Names in the expressions of a step, and of the line of the plan to which it goes."""
    values = [
        *step.args.values(),
        *(value for line in script.plan if line.name == step.to for value in (line.by, line.turn_rad)),
    ]
    for value in values:
        yield from expressions.names(str(value))
