"""The sentence that asks the operator for what no script has achieved (R81). Pure.

It keeps the regions of the sentence, which protect something. The other limits and the reflexes were those of the
program's motions.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol.advice import fill_in, sentences_of
from rtc.protocol.outcomes import Refused
from rtc.protocol.sentence import OPERATOR, SHARED, ParsedCommand
from workers.mechanisms.mechanism import Needs
from workers.tasks import command_fields
from workers.tasks.candidate import TaskCandidate
from workers.tasks.sentence_of import sentence_of

Scripts = Mapping[str, ScriptFile]
KEPT_LIMITS = ("AVOID-TASK-REGION", "SAFE-WORK-RANGE")


def by_operator(program: ElaboratorProgram, scripts: Scripts, candidate: TaskCandidate, needs: Needs) -> str:
    """The same task VIA OPERATOR-INTERVENTION. For a task with an object and without such a script, the
    sentence that gives the arm to the operator.

    Empty if it is given already, and while two hands hold one object: one of them does not move alone."""
    parsed, arm = candidate.parsed, candidate.hand
    shares = any(constraint.slot == SHARED for constraint in parsed.constraints)
    if arm is None or parsed.performer == OPERATOR or shares or candidate.query.sharers(arm.name):
        return ""
    row = program.clears.get("operator", []) if candidate.thing else []
    give = next(iter(sentences_of(fill_in(row, {"arm": hand_in_words(arm.name)}))), "")
    return _same_task(program, scripts, candidate, needs) or give


def _same_task(program: ElaboratorProgram, scripts: Scripts, candidate: TaskCandidate, needs: Needs) -> str:
    """The same task VIA OPERATOR-INTERVENTION; empty if no script is for it, or if what the script needs is not so."""
    parsed, place = candidate.parsed, candidate.parsed.place
    if candidate.partner is not None or (place is not None and not place.name):
        return ""
    asked = replace(parsed, performer=OPERATOR, path=None, through=[])
    rows = (row for row in program.branches[parsed.verb] if row.enabled and row.by_operator)
    row = next((row for row in rows if command_fields.fits_sentence(row, asked)), None)
    if row is None or not _is_used(asked, scripts[row.script]):
        return ""
    if any(needs[need](candidate) for need in scripts[row.script].needs):
        return ""
    sentence = sentence_of(
        replace(
            asked,
            performer=None,
            hand=candidate.arm.name,
            grasp_point=candidate.point.name if candidate.point is not None else None,
            constraints=[one for one in parsed.constraints if one.slot in KEPT_LIMITS and one.name],
            reflexes=[],
            guarded=False,
        )
    )
    return sentence and f"{sentence} VIA {OPERATOR}-INTERVENTION"


def _is_used(parsed: ParsedCommand, script: ScriptFile) -> bool:
    """Whether the script achieves all that the sentence asks for."""
    try:
        command_fields.refuse_unused_field(parsed, script.script, script.uses, performer=True)
    except Refused:
        return False
    return True
