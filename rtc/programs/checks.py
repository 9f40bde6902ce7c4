"""Checks of programs at load time, beyond their types: unknown names, and expressions that never have a value. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

from rtc.model.cells.parts import Numbers
from rtc.programs import (
    attributes,
    expressions,
    extension_names,
    named_algorithms,
    plugin_fields,
    recovery,
    splice,
    step_kinds,
    words_of_packages,
)
from rtc.programs.schema import (
    AnalyzerProgram,
    BinderProgram,
    BranchCondition,
    ElaboratorProgram,
    ScriptFile,
    ScriptStep,
    StopRow,
)
from rtc.protocol.advice import Advice
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import OF_OPERATOR, Reflex, StopReason
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.spelling import unknown
from rtc.protocol.units import SUFFIXES

Problems = Iterator[tuple[str, str]]  # place, problem

PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
FIELDS = ParsedCommand.__struct_fields__
SENTENCE_FIELDS = (*FIELDS, "shared")  # of conditions on a sentence
#: meanings (rtc.language.meaning) of productions that begin with a verb
_OPENS = "command|handoff|verify|set_value|cannot"


class PlacedStep(NamedTuple):
    """A step of a script or piece, with its place in the program.

    `bindings`: the names that a step of the script may refer to; None in a piece, which has those of its script.
    `entries`: length of the trimming stack.
    """

    place: str
    step: ScriptStep
    bindings: set[str] | None = None
    entries: int = 0


def steps_of(program: ElaboratorProgram) -> Iterator[PlacedStep]:
    """Every step of an elaborator program. A step that names a piece has the steps of that piece, at its place."""
    pieces = {piece.skill: piece for piece in program.pieces}
    for n, script in enumerate(program.scripts):
        lets = {step.name for step in splice.flat(script.steps, pieces) if step.do == "let"}
        bindings = {line.name for line in script.plan} | lets
        for m, step in enumerate(script.steps):
            for own in splice.flat([step], pieces):
                yield PlacedStep(f"scripts[{n}].steps[{m}]", own, bindings, len(script.trimming_stack))
    for n, piece in enumerate(program.pieces):
        for m, step in enumerate(piece.steps):
            for own in splice.flat([step], pieces):
                yield PlacedStep(f"pieces[{n}].steps[{m}]", own)


def _elaborator(program: ElaboratorProgram) -> Problems:
    if problems := list(splice.problems(program)):
        yield from problems
        return
    yield from named_algorithms.problems(program)
    yield from plugin_fields.problems(program)
    scripts = {script.script for script in program.scripts}
    of_object = attributes.figures(program)
    figures = {*extension_names.FIGURES, *of_object}
    figures |= {name for row in program.command_object_table for name in row.values}
    for attribute, form in program.settable.items():
        yield from known("unit", form.unit, ("", attributes.PLAIN, *SUFFIXES), f"settable.{attribute}.unit")
    for n, row in enumerate(program.command_object_table):
        for name, value in ((name, value) for name, value in row.values.items() if isinstance(value, str)):
            place = f"command_object_table[{n}].values.{name}"
            yield from _expression(value, place, {*Numbers.__struct_fields__, *of_object})
    for n, branch in enumerate(program.decision_tree):
        yield from known("script", branch.script, scripts, f"decision_tree[{n}].script")
        for m, check in enumerate(branch.when):
            place = f"decision_tree[{n}].when[{m}]"
            yield from _bounds(check, place)
            yield from _declared(check, place, of_object)
            for field in filter(None, (check.given, check.missing, *check.equals, *check.differs)):
                yield from known("field of a sentence", field.partition(".")[0], SENTENCE_FIELDS, place)
    for slot, units in program.constraints.items():
        for unit, limit in units.items():
            yield from known("limit", limit, ("", *Limits.__struct_fields__), f"constraints.{slot}.{unit}")
    for figure, most in program.by_hand.items():
        yield from known("figure of the hand", most, extension_names.HAND_LIMITS, f"by_hand.{figure}")
    for attribute, skill in program.senses.items():
        yield from known("piece", skill, {piece.skill for piece in program.pieces}, f"senses.{attribute}")
    for n, entry in enumerate(program.reserve):
        yield from known("piece", entry.skill, {piece.skill for piece in program.pieces}, f"reserve[{n}].skill")
    for n, script in enumerate(program.scripts):
        yield from _script(script, f"scripts[{n}]", figures)
    for placed in steps_of(program):
        yield from _step(placed, figures)


def _script(script: ScriptFile, place: str, figures: set[str]) -> Problems:
    for n, field in enumerate(script.uses):
        yield from known("field of a sentence", field, FIELDS, f"{place}.uses[{n}]")
    for n, need in enumerate(script.needs):
        yield from _word("condition of the world", need, extension_names.NEEDS, f"{place}.needs[{n}]")
    for section in ("resources", "writes"):
        for n, role in enumerate(getattr(script, section)):
            if role != role.upper():  # a name of the cell is in capitals
                yield from known("resource", role, extension_names.ROLES, f"{place}.{section}[{n}]")
    if script.unsure_if is not None:
        yield from _bounds(script.unsure_if, f"{place}.unsure_if")
        yield from _declared(script.unsure_if, f"{place}.unsure_if", figures)
    planned: list[str] = []
    for n, line in enumerate(script.plan):
        yield from _word("anchor", line.at, [*extension_names.ANCHORS, *planned], f"{place}.plan[{n}].at")
        if line.along:
            yield from known("axis", line.along, extension_names.PLAN_AXES, f"{place}.plan[{n}].along")
        yield from _expression(line.by, f"{place}.plan[{n}].by", figures)
        yield from known("earlier line", line.near, ("", *planned), f"{place}.plan[{n}].near")
        planned.append(line.name)
    for n, entry in enumerate(script.trimming_stack):
        if entry.n != n + 1:
            yield f"{place}.trimming_stack[{n}].n", f"entries are numbered in order from 1; this is number {n + 1}"
        used = [m for m, step in enumerate(script.steps) if entry.drift and _may_use(step, entry.n)]
        for m in used:
            yield f"{place}.steps[{m}].trim", f"entry {entry.n} is for a drift, not for a failure of a step"
    if script.trimming_stack and script.case < 3:
        yield f"{place}.trimming_stack", "actions (cases 1 and 2) cannot be trimmed"
    poses = {line.name for line in script.plan if not line.solve}
    poses |= {"HERE", *(step.name for step in script.steps if step.do == "let")}
    for n, step in enumerate(script.steps):
        about = step.words.get("about", "HERE")
        yield from known("pose of the plan (without solve)", about, poses, f"{place}.steps[{n}].words.about")


def _may_use(step: ScriptStep, entry: int) -> bool:
    first, count = step.trim
    return first <= entry < first + count


def _step(placed: PlacedStep, figures: set[str]) -> Problems:
    place, step, bindings, entries = placed
    for field, text in (("label", step.label), *((f"words.{name}", text) for name, text in step.words.items())):
        for name in PLACEHOLDER.findall(text):
            yield from known("placeholder", name, extension_names.PLACEHOLDERS, f"{place}.{field}")
    yield from step_kinds.problems(step, place)
    yield from _path(step, place)
    index, count = step.trim
    if (index, count) != (0, 0) and not (index >= 1 and count >= 1 and index + count - 1 <= entries):
        yield f"{place}.trim", f"[index, count] = [{index}, {count}] is outside the trimming stack of {entries} entries"
    if bindings is not None:
        yield from known("binding", step.to, {"", "HERE", *bindings}, f"{place}.to")
    yield from known("performer", step.who, extension_names.PERFORMERS, f"{place}.who")
    if step.space or step.to:
        yield from known("space", step.space or "(none)", extension_names.SPACES, f"{place}.space")
    for name, source in step.keep.items():
        yield from known("measured value", source, extension_names.KEPT_VALUES, f"{place}.keep.{name}")
    if "{" not in (axis := step.words.get("axis", "X")):
        yield from known("axis", axis, extension_names.PLAN_AXES, f"{place}.words.axis")
    for name, expression in step.args.items():
        yield from _expression(expression, f"{place}.args.{name}", figures)
    yield from _expression(step.value or None, f"{place}.value", bindings, "binding")


def _path(step: ScriptStep, place: str) -> Problems:
    """Figures that would not shape the path of the step."""
    curve = step.space in step_kinds.CURVES
    if curve and step.to != "HERE":
        yield f"{place}.to", f"{step.space} begins HERE, not at {step.to or 'nothing'}"
    for name in ("by_m", "by_rad"):
        if name in step.args and step.to != "HERE":
            yield f"{place}.args.{name}", f"{name} is a step from HERE, not from {step.to or 'nowhere'}"
    if step.words.get("axis") == extension_names.WAY_OUT:
        if step.to != "HERE" or step.space not in ("move_task", "move_both") or "by_m" not in step.args:
            yield f"{place}.words.axis", "WAY-OUT is for a move_task or a move_both from HERE by_m"
        for name in ("by_rad", "press_n", "spin_m"):
            if name in step.args:
                yield f"{place}.args.{name}", f"{name} has no effect along WAY-OUT"
    if "through" in step.words and step.to == "HERE":
        yield f"{place}.words.through", "a way through places leads to a pose or to joint values of the plan"
    if "around" in step.words and step.space != "move_both":
        yield f"{place}.words.around", "around is for a move_both"
    if "press_n" in step.args and step.space == "move_circle":
        yield f"{place}.args.press_n", f"a {step.space} has no axis to press along"
    if "beyond_m" in step.args and StopReason.CONTACT not in step.expect:
        yield f"{place}.args.beyond_m", "beyond_m is of a touch, which `expect` of the step does not name"


def _binder(program: BinderProgram) -> Problems:
    yield from named_algorithms.problems(program)
    yield from _values(program.values, "values")
    for name, row in program.stop_classes.items():
        yield from _values(row.values, f"stop_classes.{name}.values")
        for n, stop in enumerate(row.stops):
            yield from _stop_row(stop, f"stop_classes.{name}.stops[{n}]")
        whens = {stop.when for stop in row.stops}
        for wanted in ("goal-reached", "time-above"):
            if wanted not in whens:
                yield f"stop_classes.{name}.stops", f"F is not complete without {wanted}"
    for op, name in program.hand.items():
        yield from known("stop class", name, program.stop_classes, f"hand.{op}")
    for name, procedure in program.procedures.items():
        yield from _word("procedure", procedure, extension_names.PROCEDURES, f"procedures.{name}")
    for n, stop in enumerate(program.holding):
        yield from _stop_row(stop, f"holding[{n}]")


def _stop_row(stop: StopRow, where: str) -> Problems:
    yield from known("predicate", stop.when, extension_names.PREDICATES, f"{where}.when")
    yield from _values({"limit": stop.limit} if stop.limit is not None else {}, where)
    if (stop.reflex is Reflex.BACK_OFF) is not (stop.back_off_m > 0.0):
        yield f"{where}.back_off_m", "a distance above 0 goes with the reflex back_off, and with no other"


def _analyzer(program: AnalyzerProgram) -> Problems:
    yield from named_algorithms.problems(program)
    yield from _trimmers(program)
    for name, failure in program.classes.items():
        again, pressing = ("target_cure", "out_first", "found_at"), ("away", "leave")
        fields = (("message", ()), ("clears", pressing[1:]), ("again", again), ("pressing", pressing))
        for field, more in fields:
            placeholders = (*extension_names.FAILURE_PLACEHOLDERS, *more)
            for word in PLACEHOLDER.findall(_text_of(getattr(failure, field))):
                yield from _word("placeholder", word, placeholders, f"classes.{name}.{field}")
    for field in ("unmet", "squeezed"):
        yield from known("class", getattr(program, field), ("", *program.classes), field)
    for row, cells in program.outcomes.items():
        missing = [reason.value for reason in StopReason if reason not in cells and reason not in OF_OPERATOR]
        if missing:
            yield f"outcomes.{row}", f"no cell for {', '.join(missing)}"
        for reason, name in cells.items():
            yield from known("class", name, program.classes, f"outcomes.{row}.{reason}")


def _text_of(row: str | Advice) -> str:
    if isinstance(row, str):
        return row
    return " ".join(text for one in row for text in (*one.sentences, one.words, *one.states))


def _trimmers(program: AnalyzerProgram) -> Problems:
    """Tables that no trimmer reads, and names in them that do not exist."""
    if recovery.RULES in program.trimmers and not program.rules:
        yield "trimmers", "rules choose nothing without a section `rules`"
    if recovery.SEARCH in program.trimmers and program.search is None:
        yield "trimmers", "a search finds nothing without a section `search`"
    figures = {*extension_names.FAILURE_FIGURES, *program.values}
    for n, rule in enumerate(program.rules):
        place = f"rules[{n}]"
        for name in rule.steps:
            yield from known("row of the outcomes", name, program.outcomes, f"{place}.steps")
        for name in rule.classes:
            yield from known("class", name, program.classes, f"{place}.classes")
        for m, one in enumerate(rule.when):
            for field in ("of", "at_least", "at_most"):
                yield from _expression(getattr(one, field), f"{place}.when[{m}].{field}", figures)
    if program.search is not None:
        made = {name for piece in program.search.pieces.values() for name in piece.makes}
        for reason, broken in program.search.breaks.items():
            for name in broken:
                yield from known("condition that a piece makes", name, made, f"search.breaks.{reason}")
        for skill, piece in program.search.pieces.items():
            for name in (*piece.needs, *piece.breaks):
                yield from known("condition that a piece makes", name, made, f"search.pieces.{skill}")


def unknown_verbs(program: ElaboratorProgram, grammar: str) -> Problems:
    """Rows for a verb with which no sentence of this grammar begins."""
    possible = verbs(grammar)
    for section in ("decision_tree", "command_object_table"):
        for n, row in enumerate(getattr(program, section)):
            yield from known("verb of the language", row.verb, possible, f"{section}[{n}].verb")


def verbs(grammar: str) -> set[str]:
    """The verbs of a grammar text, found without compiling it, which would take too long for the broker."""
    found = re.findall(rf"[:|]\s*([A-Z_]+)\b[^\n|:]*->\s*(?:{_OPENS})\b", grammar)
    return {verb.replace("_", "-") for verb in found}


def _bounds(condition: BranchCondition, place: str) -> Problems:
    for field in ("of", "at_least", "at_most"):
        yield from _expression(getattr(condition, field), f"{place}.{field}")


def _declared(condition: BranchCondition, place: str, of_object: Collection[str]) -> Problems:
    """Attributes of the object in a condition that no row of `settable` declares."""
    for name in sorted(attributes.of_conditions([condition])):
        yield from known("attribute of an object (declared in `settable`)", name, of_object, place)


def _values(values: dict[str, str | float], place: str) -> Problems:
    for name, expression in values.items():
        yield from _expression(expression, f"{place}.{name}")
        if attributes.PREFIX in str(expression):
            yield f"{place}.{name}", "attributes of objects are figures of scripts; state it in the `args` of a step"


def _expression(
    text: str | float | None, place: str, names: Collection[str] | None = None, kind: str = "figure"
) -> Problems:
    """An expression without a value, or with a name that is not among `names`; None: it may have any names."""
    if text is None:
        return
    try:
        if problem := valueless(str(text)):
            yield place, problem
        for name in sorted(expressions.names(text)):
            if names is not None:
                yield from _word(kind, name, names, place)
    except expressions.ExpressionError as error:
        yield place, str(error)


def valueless(expression: str) -> str:
    """The reason why an expression has no value for any values of its names; empty when it may have one.

    Two samples are tried. Raises ExpressionError for a text that is not an expression.
    """
    names = sorted(expressions.names(expression))
    complaint = ""
    for sample in (1.37, 0.61):
        try:
            expressions.evaluate(expression, {name: sample * (n + 1) ** 0.5 for n, name in enumerate(names)})
            return ""
        except expressions.ExpressionError as error:
            complaint = str(error)
    return f"{expression!r} has no value: {complaint}"


def _word(kind: str, name: str, names: Collection[str], place: str) -> Problems:
    """As `known`, for a word that an installed mechanism may add."""
    if not words_of_packages.added(name):
        yield from ((at, text + words_of_packages.why_unknown(name)) for at, text in known(kind, name, names, place))


def known(kind: str, name: str, names: Collection[str], place: str) -> Problems:
    if name not in names:
        yield place, unknown(kind, name, filter(None, names))


CHECKS: dict[type[Any], Callable[[Any], Problems]] = {
    ElaboratorProgram: _elaborator,
    BinderProgram: _binder,
    AnalyzerProgram: _analyzer,
}
