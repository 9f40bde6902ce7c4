"""The sentence that asks the operator for what no script has achieved (R81). Pure.

It keeps the regions of the sentence, which protect something. The other limits and the reflexes were those of the
program's motions.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from rtc.language.hands import hand_in_words
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.advice import fill_in, sentences_of
from rtc.protocol.outcomes import Refused
from rtc.protocol.sentence import OPERATOR, SHARED, ParsedCommand, Quantity
from rtc.protocol.units import in_words
from workers.elaborator import command_fields
from workers.elaborator.preconditions import NEEDS
from workers.elaborator.script_options import fits_sentence
from workers.tasks.candidate import TaskCandidate

KEPT_LIMITS = ("AVOID-TASK-REGION", "SAFE-WORK-RANGE")


def by_operator(program: ElaboratorProgram, scripts: Mapping[str, ScriptFile], candidate: TaskCandidate) -> str:
    """The same task VIA OPERATOR-INTERVENTION. For a task with an object and without such a script, the
    sentence that gives the arm to the operator.

    Empty if it is given already, and while two hands hold one object: one of them does not move alone."""
    parsed, arm = candidate.parsed, candidate.hand
    if arm is None or parsed.performer == OPERATOR or _shares(parsed) or candidate.query.sharers(arm.name):
        return ""
    return _same_task(program, scripts, candidate) or _the_arm(program, candidate, arm.name)


def _same_task(program: ElaboratorProgram, scripts: Mapping[str, ScriptFile], candidate: TaskCandidate) -> str:
    """The same task VIA OPERATOR-INTERVENTION; empty if no script is for it, or if what the script needs is not so."""
    parsed = candidate.parsed
    if candidate.partner is not None:
        return ""
    asked = msgspec.structs.replace(parsed, performer=OPERATOR, path=None, through=[])
    rows = (row for row in program.branches[parsed.verb] if row.enabled and row.by_operator)
    row = next((row for row in rows if fits_sentence(row, asked)), None)
    words = "" if row is None or not _is_used(asked, scripts[row.script]) else _words(candidate)
    if row is None or not words or any(NEEDS[need](candidate) for need in scripts[row.script].needs):
        return ""
    regions = [f"{one.slot} {one.name}" for one in parsed.constraints if one.slot in KEPT_LIMITS and one.name]
    kept = f"MAINTAIN {' AND '.join(regions)}" if regions else ""
    return " ".join(filter(None, (words, kept, f"VIA {OPERATOR}-INTERVENTION")))


def _the_arm(program: ElaboratorProgram, candidate: TaskCandidate, arm: str) -> str:
    """The sentence that gives the arm for a task with an object; empty if the program has none."""
    row = program.clears.get("operator", []) if candidate.thing else []
    return next(iter(sentences_of(fill_in(row, {"arm": hand_in_words(arm)}))), "")


def _shares(parsed: ParsedCommand) -> bool:
    return any(constraint.slot == SHARED for constraint in parsed.constraints)


def _is_used(parsed: ParsedCommand, script: ScriptFile) -> bool:
    """Whether the script achieves all that the sentence asks for."""
    try:
        command_fields.refuse_unused_field(parsed, script.script, script.uses, performer=True)
    except Refused:
        return False
    return True


def _words(candidate: TaskCandidate) -> str:
    """Verb, names and amount; empty for a destination without a name."""
    parsed, hand = candidate.parsed, hand_in_words(candidate.arm.name)
    if parsed.place is not None:
        return f"{parsed.verb} {hand} TO {parsed.place.name}" if parsed.place.name else ""
    point = candidate.point.name if candidate.point is not None else ""
    amount = f"BY {_in_words(parsed.amount)}" if parsed.amount is not None else ""
    return " ".join(filter(None, (parsed.verb, parsed.object, point, amount, f"WITH {hand}")))


def _in_words(amount: Quantity) -> str:
    words = in_words(amount.value, amount.unit).upper()
    return f"{words}S" if amount.unit == "turn" and amount.value != 1.0 else words
