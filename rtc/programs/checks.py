"""Checks of programs at load time, beyond their types: unknown names, and expressions that never have a value. Pure."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

from rtc.language.alike import unknown
from rtc.programs import expressions, extension_names
from rtc.programs.compatibility import Problems
from rtc.programs.schema import AnalyzerProgram, ElaboratorProgram, ScriptFile, ScriptStep
from rtc.protocol.sentence import ParsedCommand

PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
FIELDS = ParsedCommand.__struct_fields__
#: meanings (rtc.language.meaning) of productions that begin with a verb
_OPENS = "command|handoff|verify|set_value|cannot"


def problems(program: ElaboratorProgram) -> Problems:
    """The problems of an elaborator program, each with its place."""
    for n, branch in enumerate(program.decision_tree):
        for m, check in enumerate(branch.when):
            place = f"decision_tree[{n}].when[{m}]"
            for field in filter(None, (check.given, check.missing, *check.equals, *check.differs)):
                yield from _known("field of a sentence", field.partition(".")[0], FIELDS, place)
    for n, script in enumerate(program.scripts):
        yield from _script(script, f"scripts[{n}]")
    for n, piece in enumerate(program.pieces):
        for m, step in enumerate(piece.steps):
            yield from _step(step, f"pieces[{n}].steps[{m}]")


def _script(script: ScriptFile, place: str) -> Problems:
    for n, field in enumerate(script.uses):
        yield from _known("field of a sentence", field, FIELDS, f"{place}.uses[{n}]")
    for section in ("resources", "writes"):
        for n, role in enumerate(getattr(script, section)):
            if role != role.upper():  # a name of the cell is in capitals
                yield from _known("resource", role, extension_names.ROLES, f"{place}.{section}[{n}]")
    poses = {line.name for line in script.plan if not line.solve}
    poses |= {step.name for step in script.steps if step.do == "let"}
    for n, step in enumerate(script.steps):
        yield from _step(step, f"{place}.steps[{n}]")
        if (about := step.words.get("about", "HERE")) != "HERE":
            yield from _known("pose of the plan (without solve)", about, poses, f"{place}.steps[{n}].words.about")


def _step(step: ScriptStep, place: str) -> Problems:
    for field, text in (("label", step.label), *((f"words.{name}", text) for name, text in step.words.items())):
        for name in PLACEHOLDER.findall(text):
            yield from _known("placeholder", name, extension_names.PLACEHOLDERS, f"{place}.{field}")
    for name in step.words:
        yield from _known("word that acts", name, extension_names.WORDS, f"{place}.words.{name}")
    yield from _path(step, place)


def _path(step: ScriptStep, place: str) -> Problems:
    """Figures that would not shape the path of the step, and curves without theirs."""
    shapes = extension_names.SPACE_ARGS.get(step.space, ())
    needed = extension_names.CURVES.get(step.space, ())
    if needed and step.to != "HERE":
        yield f"{place}.to", f"{step.space} begins HERE, not at {step.to or 'nothing'}"
    for name in step.args:
        if name in extension_names.SHAPING and name not in shapes:
            yield f"{place}.args.{name}", f"{name} does not shape a path in {step.space or 'no space'}"
        if name in ("by_m", "by_rad") and step.to != "HERE":
            yield f"{place}.args.{name}", f"{name} is a step from HERE, not from {step.to or 'nowhere'}"
    for name in needed:
        if name not in step.args and name not in step.words:
            yield place, f"{step.space} needs {name}"
    if "about" in step.words and "about" not in needed:
        yield f"{place}.words.about", f"about is the axis of a move_circle, not of {step.space or 'no space'}"
    if step.words.get("axis") == extension_names.WAY_OUT:
        if step.to != "HERE" or step.space != "move_task" or "by_m" not in step.args:
            yield f"{place}.words.axis", "WAY-OUT is for a move_task from HERE by_m"
        for name in ("by_rad", "press_n", "spin_m"):
            if name in step.args:
                yield f"{place}.args.{name}", f"{name} has no effect along WAY-OUT"
    if "through" in step.words and (needed or step.to == "HERE" or not step.space):
        yield f"{place}.words.through", "a way through places leads to a pose or to joint values of the plan"
    if "press_n" in step.args and "about" in needed:
        yield f"{place}.args.press_n", f"a {step.space} has no axis to press along"


def failure_words(program: AnalyzerProgram) -> Problems:
    """Unknown placeholders in the messages of failure classes."""
    for name, row in program.classes.items():
        fields = (("message", ()), ("clears", ()), ("again", ("target_cure",)), ("pressing", ("away", "leave")))
        for field, more in fields:
            known = (*extension_names.FAILURE_PLACEHOLDERS, *more)
            for word in PLACEHOLDER.findall(getattr(row, field)):
                yield from _known("placeholder", word, known, f"classes.{name}.{field}")


def unknown_verbs(program: ElaboratorProgram, grammar: str) -> Problems:
    """Rows for a verb with which no sentence of this grammar begins."""
    known = verbs(grammar)
    for section in ("decision_tree", "command_object_table"):
        for n, row in enumerate(getattr(program, section)):
            yield from _known("verb of the language", row.verb, known, f"{section}[{n}].verb")


def verbs(grammar: str) -> set[str]:
    """The verbs of a grammar text, found without compiling it, which would take too long for the broker."""
    found = re.findall(rf"[:|]\s*([A-Z_]+)\b[^\n|:]*->\s*(?:{_OPENS})\b", grammar)
    return {verb.replace("_", "-") for verb in found}


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


def _known(what: str, name: str, known: Collection[str], place: str) -> Iterator[tuple[str, str]]:
    if name not in known:
        yield place, unknown(what, name, known)
