"""Sentences that move nothing, as reports: stated facts, which the analyzer judges and writes (A24); answers. Pure."""

from __future__ import annotations

from typing import Any

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import by_sentence
from rtc.protocol.messages import BoundStep, EndReport, EvaluationContext, Validity
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from workers.tasks.bind_task import BindTask, refused_program

NOW = "now"  # key of a stated value that stands for a fact
#: performers in the report of facts that a command states, and of an answer
STATED_BY, ANSWERED_BY = "OPERATOR", "RTC"


def _now(task: BindTask, stated: Any) -> Any:
    """A stated value; {"now": KEY} stands for the value of that fact now. Raises Refused if it is not valid."""
    if not isinstance(stated, dict) or NOW not in stated:
        return stated
    fact = task.query.world.get(stated[NOW])
    if fact is not None and fact.validity is Validity.VALID:
        return fact.value
    arm = stated[NOW].partition(".")[0]
    raise Refused.because(
        RefusalReason.SUSPECT,
        f"{stated[NOW]} is {fact.validity.value if fact else 'unknown'}: where {arm} stands is not sure",
        where=stated[NOW],
        clears=by_sentence(f"HOLD {hand_in_words(arm)} FOR 1 SEC", words="it reads the joints first"),
    )


def bind_stated_facts(task: BindTask) -> BoundStep:
    """Raises Refused if the command states none, or one that stands for a fact that is not valid."""
    stated = task.data.context.stated
    if not stated:
        raise refused_program("the command states no facts", "a script for a command that states facts")
    return _reported(task, STATED_BY, "stated", {key: _now(task, value) for key, value in stated.items()})


def bind_answer(task: BindTask) -> BoundStep:
    """An answer that the elaborator has given, as a report without facts."""
    return _reported(task, ANSWERED_BY, "answered", {})


def _reported(task: BindTask, performer: str, note: str, facts: dict[str, Any]) -> BoundStep:
    """The step as done: nothing moves, so there is no arm time."""
    report = EndReport(
        primitive=task.data.primitive_id,
        performer=performer,
        reason=StopReason.GOAL,
        at_s=0.0,
        duration_s=0.0,
        facts=facts,
    )
    evaluation = EvaluationContext(context=task.data.context, step=task.data.step)
    return BoundStep(report=report, evaluation=evaluation, note=note)
