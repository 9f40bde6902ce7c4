"""Words of a program that a mechanism of an installed package adds (`rtc.mechanisms`), such as `tare.zeroed`. Pure.

The name of the entry point comes before the point. So no word of a package is one of ours, and a program that is loaded
shows whose word it is. Its check imports no package: it knows the names of mechanisms. A worker that compiles the
program knows the words.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from rtc.plugins import registry
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram

RESERVED = ("object", "report")  # `object.mass_kg` is a figure, `report.pose` a measured value
PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


class AddedWord(NamedTuple):
    place: str  # in the program
    tables: tuple[str, ...]  # the fields of `workers.mechanisms.mechanism.Mechanism`, one of which must have it
    name: str
    figures: tuple[str, ...] = ()  # that the step states


def owner(word: str) -> str:
    """NAME of NAME.word; empty if it has no such form."""
    name, point, _ = word.partition(".")
    return name if point and name.isidentifier() and name not in RESERVED else ""


def added(word: str) -> bool:
    """Whether an installed mechanism has words of this form."""
    return owner(word) in registry.names(registry.MECHANISMS)


def why_unknown(word: str) -> str:
    """What an unknown word of this form lacks; empty for one of another form."""
    return f"; no installed package has a mechanism {owner(word)}" if owner(word) else ""


def words(program: Any) -> Iterator[AddedWord]:
    """All words of packages in a program."""
    return (word for word in _words(program) if added(word.name))


def _words(program: Any) -> Iterable[AddedWord]:
    if isinstance(program, ElaboratorProgram):
        for n, script in enumerate(program.scripts):
            for m, need in enumerate(script.needs):
                yield AddedWord(f"scripts[{n}].needs[{m}]", ("needs",), need)
            for m, line in enumerate(script.plan):
                yield AddedWord(f"scripts[{n}].plan[{m}].at", ("anchors",), line.at)
        for section in ("scripts", "pieces"):
            for n, item in enumerate(getattr(program, section)):
                for m, step in enumerate(item.steps):
                    yield AddedWord(f"{section}[{n}].steps[{m}].do", ("actions",), step.do, tuple(step.args))
                    for word in ("effect", "missed"):
                        yield AddedWord(
                            f"{section}[{n}].steps[{m}].words.{word}", ("effects",), step.words.get(word, "")
                        )
    elif isinstance(program, BinderProgram):
        yield from (AddedWord(f"procedures.{name}", ("procedures",), of) for name, of in program.procedures.items())
    elif isinstance(program, AnalyzerProgram):
        for name, row in program.classes.items():
            for text in (row.message, row.clears, row.again, row.pressing):
                yield from (
                    AddedWord(f"classes.{name}", ("texts", "advice"), one) for one in PLACEHOLDER.findall(str(text))
                )
