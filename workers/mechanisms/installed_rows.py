"""Mechanisms of installed packages (`rtc.mechanisms`): their rows are checked once, and their functions are guarded.

A row that cannot be used is left out, with the reason: what it would add is unknown then. A function that fails, takes
too long, or returns another kind of value than its field of `Mechanism` states refuses the sentence with its name. Pure
if they are.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import functools
import math
import numbers
import types
import typing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.programs import step_kinds, words_of_packages
from rtc.protocol import wire
from rtc.protocol.messages import InstalledStep
from rtc.protocol.outcomes import ProgramError
from rtc.protocol.spelling import unknown
from workers.mechanisms.mechanism import Mechanism

#: fields whose keys are words of programs: a package has its own, NAME.word
WORDS = (
    *("needs", "anchors", "foreseen", "actions", "procedures", "effects", "violated", "interrupted", "after_failure"),
    *("found", "texts", "advice", "reads"),
)
#: those of them that are about an effect of the row
OF_EFFECTS = ("foreseen", "violated", "interrupted", "after_failure", "found")
#: fields with keys that all mechanisms share: each key belongs to one of them
SHARED = ("stated", "plausible", "cures")
#: fields that decide for a whole stage, or about a kind of primitive; each has its rows among ours
OURS = ("candidates", "performers", "states", "reports")
MOST_PARTS = 10_000  # of a list that a function returns


class InstalledRows(NamedTuple):
    used: tuple[Mechanism, ...] = ()
    failed: Mapping[str, str] = types.MappingProxyType({})  # name -> why its row is not used


def load(ours: Sequence[Mechanism]) -> InstalledRows:
    """All rows of installed packages."""
    found, failed = registry.loaded(registry.MECHANISMS)
    used, failed = list[Mechanism](), dict(failed)
    for name, row in found.items():
        try:
            with registry.guarded(registry.MECHANISMS, name):
                problem = next(_problems(row, name, [*ours, *used]), "")
        except PluginError as error:
            problem = error.problem
        if problem:
            failed[name] = problem
        else:
            used.append(_guarded(row))
    return InstalledRows(tuple(used), failed)


def refuse_missing(program: Any, rows: InstalledRows) -> None:
    """Raises ProgramError for a word of a package that this process does not have."""
    by_name = {row.name: row for row in rows.used}
    common = step_kinds.figures_of(InstalledStep) | step_kinds.values_of(InstalledStep, ())
    for added in words_of_packages.words(program):
        place, word, name = added.place, added.name, words_of_packages.owner(added.name)
        if name not in by_name:
            raise ProgramError(f"$.{place}: {word}: {rows.failed.get(name, 'no installed package has it')}")
        known = [key for table in added.tables for key in getattr(by_name[name], table)]
        if word not in known:
            raise ProgramError(f"$.{place}: {unknown(f'word of the mechanism {name}', word, known)}")
        for figure in added.figures:
            if figure not in (read := common | {*by_name[name].reads.get(word, ())}):
                raise ProgramError(f"$.{place}: {unknown('figure of a step', figure, read)}")


# --- what a row may state --------------------------------------------------------------------------------


def _problems(row: Any, name: str, earlier: Sequence[Mechanism]) -> Iterator[str]:
    """Why a row cannot be used."""
    if not isinstance(row, Mechanism):
        yield f"it is no Mechanism, but {type(row).__name__}"
        return
    if row.name != name:
        yield f"the name of its row is {row.name}, and that of its entry point {name}"
    if not name.isidentifier() or name in words_of_packages.RESERVED:
        yield f"{name} is no name of a mechanism: letters, digits and _ are, without {words_of_packages.RESERVED}"
    for other in earlier:
        if other.name == name:
            yield f"{name} is the name of another mechanism"
        for table in (*WORDS, *SHARED):
            for word in getattr(row, table):
                if word in getattr(other, table):
                    yield f"{word} in its {table} is one of the mechanism {other.name}"
    for table in WORDS:
        for word in getattr(row, table):
            if not isinstance(word, str) or words_of_packages.owner(word) != name:
                yield f"{word} in its {table} does not begin with {name}."
    for table in OF_EFFECTS:
        for word in getattr(row, table):
            if word not in row.effects:
                yield f"{word} in its {table} is none of its effects"
    for word, figures in checked(row.reads, Mapping[str, Collection[str]]).items():
        if word not in row.actions:
            yield f"{word} reads {', '.join(figures)}, and is none of its actions"
    for field in OURS:
        if getattr(row, field):
            yield f"{field} is no field for a package"
    if row.piece is not None and not row.piece.__struct_config__.forbid_unknown_fields:
        yield f"{row.piece.__name__}, its piece of the cell, does not forbid unknown fields"


# --- the guard round each function -----------------------------------------------------------------------


def _guarded(row: Mechanism) -> Mechanism:
    """The row with a guard round each of its functions."""
    changed: dict[str, Any] = {}
    for field, hint in _hints().items():
        value, returns = getattr(row, field), _returned(hint)
        if isinstance(value, Mapping) and field != "reads":
            changed[field] = {key: _call(one, row.name, field, returns) for key, one in value.items()}
        elif isinstance(value, tuple):
            changed[field] = tuple(_call(one, row.name, field, returns) for one in value)
        elif callable(value) and field != "piece":
            changed[field] = _call(value, row.name, field, returns)
    return dataclasses.replace(row, **changed)


def _call(function: Callable[..., Any], name: str, field: str, returns: Any) -> Callable[..., Any]:
    """The function, whose result is what `returns` states. Raises Refused and PluginError."""

    @functools.wraps(function)
    def guarded(*given: Any) -> Any:
        with registry.guarded(registry.MECHANISMS, name):
            found = checked(function(*given), returns)
            if field == "figures" and (stray := [one for one in found if words_of_packages.owner(one) != name]):
                raise ValueError(f"the figure {stray[0]} does not begin with {name}.")
        return found

    return guarded


@functools.cache
def _hints() -> dict[str, Any]:
    return {name: hint for name, hint in typing.get_type_hints(Mechanism).items() if name != "name"}


def _returned(hint: Any) -> Any:
    """What the functions of a field return."""
    origin, given = typing.get_origin(hint), typing.get_args(hint)
    if origin is collections.abc.Callable:
        return given[1]
    if origin is collections.abc.Mapping:
        return _returned(given[1])
    return _returned(given[0]) if given else None  # of a tuple, and of what may be None


def checked(value: Any, form: Any) -> Any:
    """What a function of a package has returned, as its reader expects it. Raises TypeError, ValueError and others."""
    origin, given = typing.get_origin(form), typing.get_args(form)
    if form is Any:
        return msgspec.json.decode(msgspec.json.encode(value))
    if form is None or form is type(None):
        return _of_kind(value, type(None))
    if origin in (typing.Union, types.UnionType):
        return _one_of(value, given)
    if origin is tuple and given[-1] is not Ellipsis:
        parts = tuple(_of_kind(value, tuple))
        return tuple(checked(part, one) for part, one in zip(parts, given, strict=True))
    if origin in (dict, collections.abc.Mapping):
        return {checked(key, given[0]): checked(part, given[1]) for key, part in dict(value).items()}
    if origin is not None:  # a list, or what is read as one
        return _parts(value, given[0])
    if form is float:
        return _finite(value)
    if form is str:
        return str.__str__(_of_kind(value, str))  # of a subclass: a method of others would run outside the guard
    if hasattr(form, "_fields"):
        hints = typing.get_type_hints(form)
        return form(
            *(checked(part, hints[name]) for name, part in zip(form._fields, _of_kind(value, form), strict=True))
        )
    return _plain(_of_kind(value, form))


def _one_of(value: Any, forms: Sequence[Any]) -> Any:
    if value is None and type(None) in forms:
        return None
    problem: Exception = TypeError("nothing is expected")
    for form in forms:
        try:
            return checked(value, form)
        except (TypeError, ValueError) as error:
            problem = error
    raise problem


def _parts(value: Any, form: Any) -> list[Any]:
    if isinstance(value, str | bytes):
        raise TypeError("expected is a list, not a text")
    parts = [checked(part, form) for part in islice(value, MOST_PARTS + 1)]
    if len(parts) > MOST_PARTS:
        raise ValueError(f"more than {MOST_PARTS} parts")
    return parts


def _finite(value: Any) -> float:
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"expected is a finite number, not {value!r:.40}")
    return float(value)


def _of_kind(value: Any, kind: Any) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"expected is {kind.__name__}, not {type(value).__name__}")
    return value


def _plain(value: Any) -> Any:
    """A message as its reader will have it: a field of another type fails here. One with a cache is no message."""
    is_message = isinstance(value, msgspec.Struct) and not hasattr(value, "__dict__")
    return wire.decoder(type(value))(wire.encode(value)) if is_message else value
