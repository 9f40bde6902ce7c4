"""Fields of a parsed command beyond its verb: converted to figures, or refused by name. Pure.

A field is never silently ignored.
"""

from __future__ import annotations

import math
from typing import Any

from rtc.model.cells.cell import Cell
from rtc.model.cells.taught import WORLD
from rtc.programs.schema import ActsOn, Branch, BranchCondition, ElaboratorProgram, ScriptFile, ScriptStep
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import SHARED_AXES, Constraint, ParsedCommand, Quantity
from rtc.protocol.units import KINDS, such_as
from rtc.subsystems.base import report_items
from workers.planning import suggestions
from workers.tasks.candidate import TaskCandidate

#: Fields of the record that scripts need not list: others act on them, or this module checks them.
EVERYWHERE = frozenset({"kind", "verb", "test", "constraints", "guarded", "reflexes", "report", "after", "now"}) | {
    "together_with"
}


#: The other fields: a script that is asked for one must list it.
LISTED = [name for name in ParsedCommand.__struct_fields__ if name not in EVERYWHERE]
NAMED = {"attitude": "attitude", "shared": "part"}  # what a limit names; other limits name a region
SOFT = "stiffness_n_m"  # figure of a compliant step
SAVED = "SAVED"  # stands for the facts of a file, in a sentence that states facts
MIN_REPORT_S = 0.1  # minimum interval of REPORT EVERY, in arm time
#: field of the record -> its words in a sentence; other fields use their own name
_WORDS = {
    "hand": "a hand",
    "object": "an object",
    "target": "a target (ON, INTO, TO, AT)",
    "amount": "BY",
    "to_value": "TO",
    "duration_s": "FOR",
    "grasp_point": "a grasp point",
    "place": "a destination",
    "place.by": "BY a distance",
    "place.joints": "JOINTS",
    "path": "STRAIGHT-LINE or JOINT-MOTION",
    "performer": "VIA",
    "through": "THROUGH",
    "until": "UNTIL",
    "shared": "MAINTAIN SHARED of a part",
    "to_hand": "a second hand",
}


def field(parsed: ParsedCommand, path: str) -> Any:
    """A field of the record by its path (place.joints); None if the field or one of its parents is not set."""
    value: Any = parsed
    for name in path.split(".") if "." in path else (path,):
        value = getattr(value, name, None)
        if value is None:
            return None
    return value or None


def fits_sentence(branch: Branch, parsed: ParsedCommand) -> bool:
    """Whether the conditions on the sentence alone hold."""
    return all(holds_for(check, parsed) for check in branch.when)


def holds_for(check: BranchCondition, parsed: ParsedCommand) -> bool:
    if check.given and field(parsed, check.given) is None:
        return False
    if check.missing and field(parsed, check.missing) is not None:
        return False
    for path, value in check.equals.items():
        if field(parsed, path) != value:
            return False
    return not check.differs or all(field(parsed, p) != v for p, v in check.differs.items())


def in_words(path: str) -> str:
    """The words of a sentence for a field of the record: BY for amount."""
    return _WORDS.get(path, path)


def refuse_unsupported(program: ElaboratorProgram, parsed: ParsedCommand) -> None:
    """Refuse a field that this release does not support."""
    for name, why in program.not_yet.items():
        if (value := field(parsed, name)) is None:
            continue
        checks = (check for branch in program.branches[parsed.verb] for check in branch.when)
        if not (isinstance(value, str) and any(check.equals.get(name) == value for check in checks)):
            raise _refused(why, name, f"leave out {in_words(name)}")


def refuse_unused_field(parsed: ParsedCommand, script: str, uses: list[str], *, performer: bool = False) -> None:
    """Refuse a field that is set but not used by the script. `performer`: VIA has chosen it."""
    for name in LISTED:
        if field(parsed, name) is not None and name not in uses and not (name == "performer" and performer):
            words = in_words(name)
            message = f"{parsed.verb} does not take {words}: its script {script} has no use for it"
            clears = f"leave out {words}; in a script of your own, put {name} into its `uses`"
            raise _refused(message, name, clears)


def refuse_saved(parsed: ParsedCommand) -> None:
    """Refuse facts of a file that came with a sentence which does not use them."""
    if (parsed.object, parsed.attribute, parsed.value) != (WORLD, "FACTS", [SAVED]):
        message = f"facts of a file came with the sentence, which does not state that {WORLD} FACTS are {SAVED}"
        raise Refused.because(RefusalReason.SENTENCE, message, clears="the sentence without them; or rtc world restore")


def limits(program: ElaboratorProgram, parsed: ParsedCommand, cell: Cell) -> Limits:
    """Limits from MAINTAIN. Raises Refused for an unsupported constraint; the refusal lists the supported ones."""
    figures: dict[str, Any] = {}
    for constraint in parsed.constraints:
        kept = program.constraints.get(constraint.slot)
        if kept is None:
            message = f"MAINTAIN {constraint.slot} is not supported"
            clears = f"leave out {constraint.slot}; supported are {', '.join(sorted(program.constraints))}"
            raise _refused(message, constraint.slot, clears)
        unit, value = argument(constraint, cell)
        if unit not in kept:
            raise _needs(constraint.slot, kept, unit, cell)
        _refuse_impossible(program, constraint.slot, kept[unit], unit, value, cell)
        if kept[unit] == "keep_out":
            figures.setdefault("keep_out", []).append(value)
        else:
            figures[kept[unit]] = value
    return Limits(**{limit: value for limit, value in figures.items() if limit})


def argument(constraint: Constraint, cell: Cell) -> tuple[str, str | float]:
    """(unit, value) of a constraint: that of the sentence, else that of the cell.

    The unit of a name is `name`; an empty unit: the constraint has no argument and no meaning here.
    """
    if constraint.name is not None:
        return "name", constraint.name
    if constraint.value is not None:
        return constraint.value.unit, constraint.value.value
    return cell.maintain.meaning(constraint.slot) or ("", 0.0)


def _refuse_impossible(
    program: ElaboratorProgram, slot: str, limit: str, unit: str, value: str | float, cell: Cell
) -> None:
    """Refuse a name that the cell lacks, or a value that no arm can keep."""
    if isinstance(value, str):
        if value not in (known := _known(limit, cell)):
            raise suggestions.unknown(NAMED.get(limit, "region"), value, known)
        return
    least, most = program.ranges.get(slot, (-math.inf, math.inf))
    if least <= value <= most:
        return
    if limit == "grip_force_n":  # the hand of the command is not known yet
        most = min(most, max(arm.gripper.max_force_n for arm in cell.arms))
    raise _outside(slot, Quantity(value, unit), least, most)


def refuse_without_effect(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a constraint, condition or reflex that applies to no step of the script."""
    parsed = candidate.parsed
    if any(condition.event == "NO-PROGRESS" for condition in parsed.conditions) and not _complies(script, parsed):
        message = f"NO-PROGRESS is about a compliant arm; {parsed.verb} moves a rigid one, which its force limit stops"
        raise _refused(message, "NO-PROGRESS", "MAINTAIN STIFFNESS, such as 600 N/M; or leave out NO-PROGRESS")
    if any(item.action == "back_off" for item in parsed.reflexes) and not any(s.do == "move" for s in script.steps):
        message = f"BACK-OFF goes back along the path of the arm, of which {parsed.verb} has none"
        raise _refused(message, "BACK-OFF", "another reflex, such as THEN STOP")
    for constraint in parsed.constraints:
        wanted = candidate.program.acts_on.get(constraint.slot)
        if wanted is None or any(_is(step, wanted) for step in script.steps):
            continue
        message = f"MAINTAIN {constraint.slot} is about {wanted.about}, of which {parsed.verb} has none"
        raise _refused(message, constraint.slot, f"leave out {constraint.slot}")


def _complies(script: ScriptFile, parsed: ParsedCommand) -> bool:
    soft = any(SOFT in step.args and not step.op for step in script.steps)
    return soft or any(constraint.slot == "STIFFNESS" for constraint in parsed.constraints)


def _is(step: ScriptStep, wanted: ActsOn) -> bool:
    does = [wanted.do] if isinstance(wanted.do, str) else wanted.do
    return (wanted.do == "" or step.do in does) and wanted.op in ("", step.op)


def refuse_report_interval(parsed: ParsedCommand) -> None:
    """Refuse a REPORT EVERY interval that is too short."""
    every_s = parsed.report.every_s if parsed.report else None
    if every_s is None or every_s >= MIN_REPORT_S:
        return
    message = f"REPORT EVERY {every_s:g} s is too often; {MIN_REPORT_S:g} s is the shortest interval"
    raise _refused(message, "EVERY", f"REPORT EVERY {MIN_REPORT_S:g} SEC, or rarer; `telemetry` has every sample")


def refuse_report_items(parsed: ParsedCommand) -> None:
    """Refuse REPORT of an item that no installed package measures, or whose package cannot be loaded."""
    for item in parsed.report.items if parsed.report else ():
        if item not in (known := report_items.known()):
            raise suggestions.unknown("report item", item, known, where="REPORT")
        if why := report_items.why_not_loaded(item):
            message = f"the report item {item} cannot be used: {why}"
            raise _refused(message, "REPORT", "correct or uninstall its package")


def refuse_longer_than_limit(parsed: ParsedCommand, limits: Limits) -> None:
    """Refuse a FOR that is longer than the TIME-LIMIT of the same sentence."""
    for_s, most_s = parsed.duration_s, limits.time_s
    if for_s is None or most_s is None or for_s <= most_s:
        return
    message = f"FOR {for_s:g} s is longer than the TIME-LIMIT, {most_s:g} s"
    raise _refused(message, "TIME-LIMIT", f"FOR {most_s:g} SEC or less, or a longer TIME-LIMIT")


def _needs(slot: str, kept: dict[str, str], unit: str, cell: Cell) -> Refused:
    """Refusal for a constraint without a value, or with a value of the wrong kind."""
    if "" in kept:
        message = f"MAINTAIN {slot} takes no name and no value here: what it would name is not supported"
        return _refused(message, slot, f"{slot} alone, or leave it out")
    ways = []
    for way, limit in kept.items():
        if way == "name":
            what = NAMED.get(limit, "region")
            ways.append(f"the name of a{'n' * (what == 'attitude')} {what}: {', '.join(_known(limit, cell))}")
        elif way in KINDS:
            ways.append(such_as(way))
    given = "" if not unit else f", not {KINDS[unit].word if unit in KINDS else f'a {unit}'}"
    needed = " or ".join(ways)
    here = "" if given else f"; {cell.name} has no meaning of its own for it (`maintain` of the cell)"
    return _refused(f"{slot} needs {needed}{given}{here}", slot, f"give {slot} {needed}, or leave it out")


def _outside(slot: str, value: Quantity, least: float, most: float) -> Refused:
    """Refusal for a value that no arm can keep."""
    unit = value.unit.upper()
    message = f"{slot} {value.value:g} {unit} is outside {least:g} to {most:g} {unit}"
    return _refused(message, slot, f"{slot} of {least:g} to {most:g} {unit}")


def _known(limit: str, cell: Cell) -> list[str]:
    if limit == "shared":
        return [*SHARED_AXES]
    return list(cell.attitudes) if limit == "attitude" else [region.name for region in cell.regions]


def _refused(message: str, where: str, clears: str) -> Refused:
    return Refused.because(RefusalReason.NO_SCRIPT, message, where=where, clears=clears)
