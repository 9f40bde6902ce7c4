"""A sentence that tells something of a thing: (program, sentence, world) -> the script that brings it to an analyzer.

Nobody moves for it, so no arm is meant and nothing is planned. Here is only seen to it that the words fit: a thing that
exists, an attribute that can be told, as many numbers as it has, in its unit. Whether what they say can be true is for
the analyzer to judge, and nothing is written here. Pure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rtc import cell as cells
from rtc.language.record import ParsedCommand
from rtc.messages import Script, ScriptContext, Step
from rtc.outcomes import Refusal, RefusalReason
from rtc.program_schema import ElaboratorProgram, ScriptFile, Tellable
from workers import naming, sentence
from workers.belief import Belief

MISSPELT = 0.75  # an attribute so like a known one is taken for a slip of the pen, not for a new one


def script(program: ElaboratorProgram, file: ScriptFile, parsed: ParsedCommand, belief: Belief) -> Script | Refusal:
    """The script, with what is told in its context."""
    misplaced = sentence.misplaced(parsed, file.script, file.uses)
    if misplaced is not None:
        return misplaced
    things = {thing.name: thing for thing in belief.cell.objects}
    thing = things.get(parsed.object or "")
    if thing is None:
        return naming.unknown("object", parsed.object or "", things)
    value = _value(program, parsed, thing, belief)
    if isinstance(value, Refusal):
        return value
    said = " ".join(str(v) if isinstance(v, str) else f"{v:.6g}" for v in parsed.value or [])
    texts = {
        "object": thing.name,
        "attribute": parsed.attribute or "",
        "value": f"{said} {parsed.value_unit or ''}".strip(),
    }
    roles = {"active_object": thing.name}
    return Script(
        context=ScriptContext(
            verb=parsed.verb,
            script=file.script,
            object=thing.name,
            told={f"{thing.name}.{_attribute(parsed)}": value},
        ),
        case=file.case,
        steps=[Step(do=step.do, label=_said(step.label, texts), expect=step.expect) for step in file.steps],
        resources=[roles.get(role, role) for role in file.resources],
        writes=[roles.get(role, role) for role in file.writes],
        candidates=[f"{file.script} {thing.name}"],
    )


def _said(words: str, texts: dict[str, str]) -> str:
    for name, text in texts.items():
        words = words.replace("{" + name + "}", text)
    return words


def _attribute(parsed: ParsedCommand) -> str:
    """As it is called in the world: HELD-BY is held_by."""
    return (parsed.attribute or "").lower().replace("-", "_")


def _value(program: ElaboratorProgram, parsed: ParsedCommand, thing: cells.Object, belief: Belief) -> Any:
    """What is to be believed, in SI; or the refusal that says how it is told."""
    attribute = _attribute(parsed)
    said: list[float | str] = parsed.value or []
    if attribute in program.not_told:
        return Refusal(
            reason=RefusalReason.NOT_ALLOWED,
            message=f"{parsed.attribute} of {thing.name} is not told, it is found out",
            where=parsed.attribute or "",
            clears=program.not_told[attribute].replace("{object}", thing.name),
        )
    if attribute in program.told:
        row = program.told[attribute]
        if parsed.value_unit != row.unit or len(said) != len(row.of):
            return _misfit(row, parsed, thing)
        fit = FITS.get(attribute)
        return fit(program, said, thing, belief) if fit else said[0] if len(said) == 1 else said
    known = [_word(name) for name in (*program.told, *program.not_told, *_others(thing, belief))]
    like = naming.nearest(parsed.attribute or "", known, MISSPELT)
    if like and parsed.attribute not in known:
        return naming.unknown("attribute", parsed.attribute or "", known, where=parsed.attribute or "")
    return said[0] if len(said) == 1 else said


def _others(thing: cells.Object, belief: Belief) -> list[str]:
    """What else is believed of it by now, because it was told before."""
    own = f"{thing.name}."
    return [key.removeprefix(own) for key in belief.world.facts if key.startswith(own)]


def _word(attribute: str) -> str:
    return attribute.upper().replace("_", "-")


def _misfit(row: Tellable, parsed: ParsedCommand, thing: cells.Object) -> Refusal:
    said = parsed.value or []
    what = "a name" if any(isinstance(v, str) for v in said) else f"{len(said)} number{'s' * (len(said) != 1)}"
    unit = f"in {parsed.value_unit}" if parsed.value_unit else "without a unit"
    return Refusal(
        reason=RefusalReason.SENTENCE,
        message=f"{parsed.attribute} of {thing.name} is {' '.join(row.of)} in {row.unit}; said was {what} {unit}",
        where=parsed.attribute or "",
        expected=[row.example],
        clears=f"say it as in {parsed.verb} {thing.name} {parsed.attribute} {row.example}",
    )


# --- where a thing is ----------------------------------------------------------------------------------------


def _frame(program: ElaboratorProgram, said: list[Any], thing: cells.Object, belief: Belief) -> Any:
    """A position; the attitude is the one believed so far. What a hand holds is where the hand is."""
    holder = belief.held_by(thing.name)
    if thing.fixed or holder:
        return Refusal(
            reason=RefusalReason.STATE,
            message=f"{thing.name} is fixed"
            if thing.fixed
            else f"{thing.name} is held by {holder}, and goes where it goes",
            clears=belief.cure(f"{thing.name}.grasp", program.clears) if holder else "",
        )
    return [*said, *belief.frame(thing.name)[3:].tolist()]


FITS: dict[str, Callable[[ElaboratorProgram, list[Any], cells.Object, Belief], Any]] = {"frame": _frame}
