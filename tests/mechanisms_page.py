"""What each mechanism can do as a page, from its row and docstrings: `python -m tests.mechanisms_page >
docs/mechanisms.md`."""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from rtc.programs import loader
from rtc.programs.schema import BinderProgram, ElaboratorProgram, ScriptStep
from rtc.programs.step_kinds import kind_of
from rtc.protocol.advice import Advice, sentences_of
from rtc.protocol.messages import BaseStep, SharedStep
from workers.mechanisms import MECHANISMS
from workers.mechanisms.mechanism import Mechanism

HEAD = """# Mechanisms

What the robot can do with each kind of thing, from the rows and docstrings of `workers/mechanisms/`. Scripts use the
words in the first columns. A package adds a mechanism: `docs/own-mechanism.md`. The page is written by
`python -m tests.mechanisms_page > docs/mechanisms.md`; a test compares it with the code.
"""
ELABORATOR = loader.decode(loader.default("elaborator"), ElaboratorProgram)
BINDER = loader.decode(loader.default("binder"), BinderProgram)

AFTER_FAILURE = [table for one in MECHANISMS for table in (one.after_failure, one.interrupted)]


def page() -> str:
    return HEAD + "".join("\n".join(("", *section(mechanism))) + "\n" for mechanism in MECHANISMS)


def section(mechanism: Mechanism) -> Iterator[str]:
    """Heading, purpose, and the tables of one mechanism."""
    folder = f"workers.mechanisms.{mechanism.name}"
    purpose, _, more = inspect.getdoc(sys.modules[folder]).partition("\n\n")  # type: ignore[union-attr]
    yield f"## {mechanism.name}\n"
    yield "\n\n".join(textwrap.fill(" ".join(part.split()), 118) for part in (purpose, more) if part)
    if verbs := verbs_of(mechanism):
        yield "\n" + textwrap.fill(f"Its words are used by the scripts of {', '.join(verbs)}.", 118)
    by_procedure = {of: name for name, of in BINDER.procedures.items()}
    steps = {kind_in_words(kind): function for kind, function in mechanism.actions.items()}
    steps |= {by_procedure.get(name, name): function for name, function in mechanism.procedures.items()}
    yield from table(("step", "what the arm, the hand or the camera does"), as_rows(steps))
    yield from table(
        ("effect", "success changes in the world", "it has gone wrong if", "what is in doubt after a failure"),
        {
            name: [
                effect,
                mechanism.violated.get(name),
                next((table[name] for table in AFTER_FAILURE if name in table), None),
            ]
            for name, effect in mechanism.effects.items()
        },
    )
    yield from table(
        ("need of a script", "it is met if", "what makes it so"),
        {name: [need, ELABORATOR.needs.get(name, [])] for name, need in mechanism.needs.items()},
    )
    yield from table(("anchor", "where a line of a plan leads"), as_rows(mechanism.anchors))
    yield from table(("attribute that SET states", "as what"), as_rows(mechanism.stated))
    yield from table(("text of a message", "what it says"), as_rows({**mechanism.texts, **mechanism.advice}))
    yield from table(("refused before any motion",), {text(check): [] for check in mechanism.checks})


def kind_in_words(kind: type[BaseStep] | str) -> str:
    """`do` of a step of this kind; of a path that the operator shares, with the column that makes it one."""
    return "operate, to" if kind is SharedStep else kind.__struct_config__.tag


def as_rows(functions: Mapping[str, Callable[..., Any]]) -> dict[str, list[Any]]:
    return {name: [function] for name, function in functions.items()}


def table(heads: tuple[str, ...], rows: Mapping[str, list[Any]]) -> Iterator[str]:
    if not rows:
        return
    yield f"\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}"
    for name, cells in rows.items():
        first = f"`{name}`" if cells else name
        yield f"| {' | '.join([first, *map(text, cells)])} |"


def text(cell: Callable[..., Any] | Advice | None) -> str:
    """The first paragraph of a docstring, or the sentences of an advice."""
    if cell is None:
        return ""
    if isinstance(cell, list):
        return "; ".join(dict.fromkeys(sentences_of(cell) or [one.words for one in cell]))
    return " ".join((inspect.getdoc(cell) or "").partition("\n\n")[0].split()).replace("|", "\\|")


def verbs_of(mechanism: Mechanism) -> list[str]:
    """The verbs with a script that uses a word of this mechanism."""
    own = {*mechanism.needs, *mechanism.anchors, *mechanism.effects}
    pieces = {piece.skill: piece.steps for piece in ELABORATOR.pieces}

    def uses(step: ScriptStep) -> bool:
        if step.do == "piece":
            return any(map(uses, pieces[step.name]))
        performs = kind_of(step) in mechanism.actions or BINDER.procedures.get(step.name) in mechanism.procedures
        return performs or bool(own & {step.words.get("effect"), step.words.get("missed")})

    found = {
        script.script
        for script in ELABORATOR.scripts
        if own & {*script.needs, *(line.at for line in script.plan)} or any(map(uses, script.steps))
    }
    return sorted({row.verb for row in ELABORATOR.decision_tree if row.script in found})


if __name__ == "__main__":
    sys.stdout.write(page())
