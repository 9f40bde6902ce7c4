"""The refusal of a job whose arithmetic fails: what it computed with has a figure that no computation bears. Pure.

The same job would fail again in every worker. What fails otherwise is a bug, and ends its worker (poison).
"""

from __future__ import annotations

from typing import Any

from rtc.plugins import guard
from rtc.protocol.advice import by_person
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world.model import World, problem

#: with `numpy.linalg.LinAlgError`, which is a ValueError
ERRORS = (ArithmeticError, ValueError)
LARGE = 1e6  # of a fact, in SI units


def doubtful(world: World) -> str:
    """A fact with a figure that no computation bears; empty without one."""
    for fact in world.facts.values():
        change = WorldChange(key=fact.key, value=fact.value, validity=fact.validity, spread=fact.spread)
        if problem(change) or any(abs(part) > LARGE for part in (*_numbers(fact.value), *(fact.spread or ()))):
            return f"{fact.key} is {fact.value!s:.80}"
    return ""


def _numbers(value: Any) -> list[float]:
    parts = value if isinstance(value, list) else [value]
    return [part for part in parts if isinstance(part, int | float)]


def refusal(kind: str, error: Exception, data: Any, doubtful: str) -> Refusal:
    """`data`: the input of the job; `doubtful`: a fact that cannot be, or ''."""
    step = getattr(data, "step", None)
    words = getattr(step, "label", "") or getattr(getattr(data, "parsed", None), "verb", "")
    cause = f"; {doubtful}" if doubtful else ""
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"the {kind} cannot compute {words or 'this'} ({guard.in_words(error)}){cause}",
        where=words,
        clears=by_person(
            "SET the fact anew" if doubtful else "other figures in the sentence; the log of the worker has the place"
        ),
    )
