"""The outcome of a command in lines for people."""

from __future__ import annotations

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.wording.measured import in_words
from rtc.wording.refusals import refusal_lines
from rtc.wording.rehearsals import in_lines


def explain(ended: m.CommandEnded, text: str) -> list[str]:
    """The cause first, then the step, then what would clear it; empty for a plain success."""
    outcome, refusal = ended.outcome, ended.outcome.refusal
    lines = [outcome.message] if outcome.message else []
    step = outcome.step if outcome.kind != OutcomeKind.SUCCEEDED else ""
    if refusal is not None and (refusal.column is not None or refusal.message not in outcome.message):
        lines = [line for line in lines if line != refusal.message]
        lines += refusal_lines(refusal, text)
        refusal = None
    if step:
        lines.append(f"in step {step}" + (f", stopped by {outcome.stop.value}" if outcome.stop else ""))
    if refusal is not None:
        lines += [line for line in refusal_lines(refusal, text) if line != refusal.message]
    lines += trims_in_words(outcome)
    lines += in_words(outcome.measured) if outcome.measured else []
    return [*lines, *in_lines(outcome.rehearsal, full=True)] if outcome.rehearsal else lines


def trims_in_words(outcome: Outcome) -> list[str]:
    """The line of its trims; none without trims."""
    if not outcome.trims:
        return []
    how = "corrected on the way by" if outcome.kind == OutcomeKind.SUCCEEDED else "tried on the way"
    return [f"{how}: {', '.join(outcome.trims)}"]
