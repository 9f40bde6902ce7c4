"""The refusal of a job whose arithmetic fails: what it computed with has a figure that no computation bears. Pure.

The same job would fail again in every worker. What fails otherwise is a bug, and ends its worker (poison).
"""

from __future__ import annotations

from typing import Any

from rtc.plugins import guard
from rtc.protocol.outcomes import Refusal, RefusalReason

#: with `numpy.linalg.LinAlgError`, which is a ValueError
ERRORS = (ArithmeticError, ValueError)


def refusal(kind: str, error: Exception, data: Any, doubtful: str) -> Refusal:
    """`data`: the input of the job; `doubtful`: a fact that cannot be, or ''."""
    step = getattr(data, "step", None)
    words = getattr(step, "label", "") or getattr(getattr(data, "parsed", None), "verb", "")
    cause = f"; {doubtful}" if doubtful else ""
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"the {kind} cannot compute {words or 'this'} ({guard.in_words(error)}){cause}",
        where=words,
        clears="SET the fact anew"
        if doubtful
        else "other figures in the sentence; the log of the worker has the place",
    )
