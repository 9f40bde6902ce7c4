"""What a sentence asks for beyond its verb, made into figures, or refused by name: never silently ignored. Pure."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.cell import Cell
from rtc.language.record import ParsedCommand
from rtc.messages import Limits
from rtc.outcomes import Refusal, RefusalReason
from rtc.program_schema import ElaboratorProgram
from workers import naming

#: fields of the record that no script has to know: what they mean is done by others, or checked here
EVERYWHERE = frozenset({"kind", "verb", "test", "constraints", "guarded", "reflexes", "report", "after", "now"}) | {
    "together_with",
    "performer",
}


def field(parsed: ParsedCommand, path: str) -> Any:
    """A field of the record by its path (place.joints); None when it, or what leads to it, is not set."""
    value: Any = parsed
    for name in path.split("."):
        value = getattr(value, name, None)
        if value is None:
            return None
    return None if value in ("", [], False) else value


def unsaid(program: ElaboratorProgram, parsed: ParsedCommand) -> Refusal | None:
    """Something this release does not do yet, if the sentence asks for it."""
    for name, why in program.not_yet.items():
        if field(parsed, name) is not None:
            return _refused(why, name, "say it without that")
    return None


def misplaced(parsed: ParsedCommand, script: str, uses: list[str]) -> Refusal | None:
    """A field that is set and that the script does not use."""
    for name in parsed.__struct_fields__:
        if name not in EVERYWHERE and name not in uses and field(parsed, name) is not None:
            return _refused(f"{parsed.verb} by the script {script} does not use {name}", name, f"say it without {name}")
    return None


def limits(program: ElaboratorProgram, parsed: ParsedCommand, cell: Cell) -> Limits | Refusal:
    """MAINTAIN as figures; a constraint that is not kept is refused, and those that are kept are listed."""
    figures: dict[str, Any] = {}
    for constraint in parsed.constraints:
        kept = program.constraints.get(constraint.slot)
        if kept is None:
            known = sorted(program.constraints)
            message = f"MAINTAIN {constraint.slot} is not kept yet; {', '.join(known)} are"
            return _refused(message, constraint.slot, "say it without that constraint", known)
        unit = "name" if constraint.name else constraint.value.unit if constraint.value else ""
        if unit not in kept:
            ways = ", ".join(_WAYS.get(way, f"a value in {way}") for way in kept)
            said = _WAYS.get(unit, f"a value in {unit}")
            message = f"MAINTAIN {constraint.slot} is kept with {ways}, not with {said}"
            return _refused(message, constraint.slot, f"give {constraint.slot} {ways}")
        limit = kept[unit]
        if limit and constraint.value is not None:
            figures[limit] = constraint.value.value
        elif limit and constraint.name is not None:
            problem = _name(limit, constraint.name, cell)
            if problem is not None:
                return problem
            figures[limit] = [constraint.name] if limit == "keep_out" else constraint.name
    return msgspec.convert(figures, Limits)


_WAYS = {"": "no value", "name": "a name"}


def _name(limit: str, name: str, cell: Cell) -> Refusal | None:
    known = list(cell.attitudes) if limit == "attitude" else [region.name for region in cell.regions]
    what = "attitude" if limit == "attitude" else "region"
    return None if name in known else naming.unknown(what, name, known)


def _refused(message: str, where: str, clears: str, expected: list[str] | None = None) -> Refusal:
    return Refusal(reason=RefusalReason.NO_SCRIPT, message=message, where=where, clears=clears, expected=expected or [])
