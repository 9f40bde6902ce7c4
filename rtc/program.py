"""Programs of the workers as bytes: put together from files, checked, named by their digest, changed by LOAD.

The program of the parser is its grammar, the others are documents of `rtc.program_schema`, kept as YAML files under
`programs/KIND/`: every file holds sections of the one document, a file in `scripts/` or `pieces/` one item (which may
bring its own rows of the tables, so that one file can add a skill). The canonical form is JSON with sorted keys, so
that equal programs have equal digests. Every complaint is a ProgramError that names the place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from rtc import expressions
from rtc.language.grammar import Grammar
from rtc.messages import Limits, WorkerKind
from rtc.outcomes import ProgramError, StopReason
from rtc.program_schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, Program, ScriptFile, ScriptStep

PROGRAMS = Path(__file__).parent / "programs"
GRAMMAR = Path(__file__).parent / "language" / "command.lark"

SCHEMAS: dict[WorkerKind, type[Program]] = {
    WorkerKind.ELABORATOR: ElaboratorProgram,
    WorkerKind.BINDER: BinderProgram,
    WorkerKind.ANALYZER: AnalyzerProgram,
}
#: list section -> the fields by which two items are the same one (LOAD puts the new one in its place)
IDENTITY: dict[str, tuple[str, ...]] = {
    "scripts": ("script",),
    "pieces": ("skill",),
    "decision_tree": ("verb", "script"),
    "command_object_table": ("verb", "kind", "name"),
}
#: the field that shows that a document is one item of a section
ITEMS: dict[str, str] = {"script": "scripts", "skill": "pieces"}

MAX_DEPTH = 30  # of maps and lists in each other; ours have 7
MAX_NODES = 50_000  # values in a document, each alias counted as what it stands for

P = TypeVar("P", bound=Program)


@lru_cache(maxsize=8)
def default(kind: WorkerKind | str) -> bytes:
    """The program of a kind of worker as it comes with the project."""
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return GRAMMAR.read_bytes()
    document: dict[str, Any] = {}
    folder = PROGRAMS / kind.value
    for path in sorted(folder.rglob("*.yaml")):
        _put(document, _read(path.read_bytes(), str(path.relative_to(PROGRAMS))), str(path.relative_to(PROGRAMS)))
    return _canonical(kind, document, str(folder.relative_to(PROGRAMS.parent)))


def merge(kind: WorkerKind | str, program: bytes, name: str, text: bytes) -> bytes:
    """The program with the document `text` (of the file `name`) put into it, in place of items of the same identity."""
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return _grammar(text, name)
    document = _read(program, f"the {kind} program in use")
    _put(document, _read(text, name), name)
    return _canonical(kind, document, name)


def decode(program: bytes, schema: type[P]) -> P:
    """The typed document of a canonical program, checked. Costs some ms; whoever uses it often keeps it by digest."""
    return _checked(_read(program, "the program"), schema, "the program")


# --- reading and putting together ------------------------------------------------------------------------


def _read(text: bytes, source: str) -> dict[str, Any]:
    try:
        document = msgspec.json.decode(text) if text.startswith(b"{") else _yaml(text, source)
    except (yaml.YAMLError, msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ProgramError(f"{source}: {error}") from error
    if not isinstance(document, dict) or not all(isinstance(key, str) for key in document):
        raise ProgramError(f"{source}: $: a program document is a map of sections, not {type(document).__name__}")
    return document


def _yaml(text: bytes, source: str) -> Any:
    """The document. Its events are looked at first: a nest that is too deep would overflow the C stack of the loader,
    and a few aliases of aliases can stand for gigabytes. Raises ProgramError, yaml.YAMLError."""
    sizes: dict[str, int] = {}  # anchor -> nodes it stands for
    open_nodes = [("", 0)]  # anchor, nodes so far
    for event in yaml.parse(text, yaml.CSafeLoader):
        anchor, nodes = "", 1
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor or "", 0))
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, nodes = open_nodes.pop()
            sizes[anchor] = nodes
        elif isinstance(event, yaml.ScalarEvent):
            sizes[event.anchor or ""] = 1
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                raise ProgramError(f"{source}: nothing is called {event.anchor}, or not yet")
            nodes = sizes[event.anchor]
        outer, before = open_nodes[-1]
        open_nodes[-1] = (outer, before + nodes)
        if len(open_nodes) > MAX_DEPTH or before + nodes > MAX_NODES:
            what = f"nested deeper than {MAX_DEPTH}" if len(open_nodes) > MAX_DEPTH else f"more than {MAX_NODES} values"
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise ProgramError(f"{source}: line {line}: {what}")
    return yaml.load(text, yaml.CSafeLoader)


def _put(whole: dict[str, Any], document: dict[str, Any], source: str) -> None:
    """Put a document's sections into the whole."""
    for field, section in ITEMS.items():
        if isinstance(document.get(field), str):
            tables = {key: document[key] for key in IDENTITY if key in document}
            item = {key: value for key, value in document.items() if key not in tables}
            document = {**tables, section: [item]}
            break
    for section, content in document.items():
        if section in IDENTITY:
            whole[section] = _replaced(whole.get(section, []), content, section, source)
        elif isinstance(content, dict) and isinstance(whole.get(section), dict):
            whole[section] = {**whole[section], **content}
        else:
            whole[section] = content


def _replaced(items: list[Any], news: Any, section: str, source: str) -> list[Any]:
    if not isinstance(news, list) or not all(isinstance(item, dict) for item in news):
        raise ProgramError(f"{source}: $.{section}: must be a list of maps")
    for n, item in enumerate(news):
        for field in IDENTITY[section]:
            if isinstance(item.get(field), list | dict | set):
                raise ProgramError(f"{source}: $.{section}[{n}].{field}: must be a name")

    def identity(item: dict[str, Any]) -> tuple[Any, ...]:
        return tuple(item.get(field) or "" for field in IDENTITY[section])

    merged = {identity(item): item for item in items}
    return list((merged | {identity(item): item for item in news}).values())


def _canonical(kind: WorkerKind, document: dict[str, Any], source: str) -> bytes:
    return msgspec.json.encode(_checked(document, SCHEMAS[kind], source), order="deterministic")


def _grammar(text: bytes, source: str) -> bytes:
    try:
        Grammar(text.decode())
    except (ProgramError, UnicodeDecodeError) as error:
        raise ProgramError(f"{source}: {error}") from error
    return text


# --- checking what types alone cannot see ----------------------------------------------------------------


def _checked(document: dict[str, Any], schema: type[P], source: str) -> P:
    try:
        program = msgspec.convert(document, schema, strict=True)
    except msgspec.ValidationError as error:
        raise ProgramError(f"{source}: {error}{_owner(document, str(error))}") from error
    for place, problem in CHECKS[schema](program):
        raise ProgramError(f"{source}: $.{place}: {problem}{_owner(document, place)}")
    return program


def _owner(document: dict[str, Any], place: str) -> str:
    """Which script a place like `scripts[3].steps[2]` is in: numbers alone are hard to find."""
    found = re.search(r"(scripts|pieces)\[(\d+)\]", place)
    if not found:
        return ""
    item = document[found[1]][int(found[2])]
    return f" (in {item.get('script') or item.get('skill') or 'a nameless one'})" if isinstance(item, dict) else ""


Problems = Iterator[tuple[str, str]]


def _elaborator_problems(program: ElaboratorProgram) -> Problems:
    scripts = {script.script for script in program.scripts}
    for n, branch in enumerate(program.decision_tree):
        if branch.script not in scripts:
            yield f"decision_tree[{n}].script", f"no script {branch.script}; there are {', '.join(sorted(scripts))}"
        for m, check in enumerate(branch.when):
            for field in ("of", "at_least", "at_most"):
                yield from _expression(getattr(check, field), f"decision_tree[{n}].when[{m}].{field}")
    for slot, units in program.constraints.items():
        for unit, limit in units.items():
            if limit and limit not in Limits.__struct_fields__:
                yield f"constraints.{slot}.{unit}", f"no limit {limit}; there are {', '.join(Limits.__struct_fields__)}"
    for n, script in enumerate(program.scripts):
        yield from _script_problems(script, f"scripts[{n}]")
    for n, piece in enumerate(program.pieces):
        for m, step in enumerate(piece.steps):
            yield from _step_problems(step, f"pieces[{n}].steps[{m}]", entries=0, bindings=None)


def _script_problems(script: ScriptFile, place: str) -> Problems:
    planned: set[str] = set()
    for n, line in enumerate(script.plan):
        yield from _expression(line.by, f"{place}.plan[{n}].by")
        if line.near and line.near not in planned:
            yield f"{place}.plan[{n}].near", f"no earlier line {line.near}"
        planned.add(line.name)
    for n, entry in enumerate(script.trimming_stack):
        if entry.n != n + 1:
            yield f"{place}.trimming_stack[{n}].n", f"entries are numbered from 1 in order; this is number {n + 1}"
    if script.trimming_stack and script.case < 3:
        yield f"{place}.trimming_stack", "actions (cases 1 and 2) cannot be trimmed (R78)"
    bindings = planned | {step.name for step in script.steps if step.do == "let"}
    for n, step in enumerate(script.steps):
        yield from _step_problems(step, f"{place}.steps[{n}]", len(script.trimming_stack), bindings)


def _step_problems(step: ScriptStep, place: str, entries: int, bindings: set[str] | None) -> Problems:
    index, count = step.trim
    if (index, count) != (0, 0) and not (index >= 1 and count >= 1 and index + count - 1 <= entries):
        yield f"{place}.trim", f"[index, count] = [{index}, {count}] leaves the trimming stack of {entries} entries"
    if bindings is not None and step.to and step.to != "HERE" and step.to not in bindings:
        yield f"{place}.to", f"nothing binds {step.to}; there are {', '.join(sorted(bindings))}"
    for name, expression in step.args.items():
        yield from _expression(expression, f"{place}.args.{name}")
    if step.value:
        yield from _expression(step.value, f"{place}.value")
        unknown = expressions.names(step.value) - bindings if bindings is not None else set()
        if unknown:
            yield f"{place}.value", f"nothing binds {', '.join(sorted(unknown))}"


def _binder_problems(program: BinderProgram) -> Problems:
    yield from _values(program.values, "values")
    for name, row in program.stop_classes.items():
        yield from _values(row.values, f"stop_classes.{name}.values")
        for n, stop in enumerate(row.stops):
            yield from _expression(stop.limit, f"stop_classes.{name}.stops[{n}].limit")
        whens = {stop.when for stop in row.stops}
        for wanted in ("goal-reached", "time-above"):
            if wanted not in whens:
                yield f"stop_classes.{name}.stops", f"F is not complete without {wanted} (R82)"
    for op, name in program.hand.items():
        if name not in program.stop_classes:
            yield f"hand.{op}", f"no stop class {name}"
    for n, stop in enumerate(program.holding):
        yield from _expression(stop.limit, f"holding[{n}].limit")


def _analyzer_problems(program: AnalyzerProgram) -> Problems:
    for row, cells in program.outcomes.items():
        missing = [reason.value for reason in StopReason if reason not in cells]
        if missing:
            yield f"outcomes.{row}", f"no cell for {', '.join(missing)} (R84)"
        for reason, name in cells.items():
            if name not in program.classes:
                yield f"outcomes.{row}.{reason}", f"no class {name}; there are {', '.join(sorted(program.classes))}"


def _values(values: dict[str, str | float], place: str) -> Problems:
    for name, expression in values.items():
        yield from _expression(expression, f"{place}.{name}")


def _expression(text: str | float | None, place: str) -> Problems:
    if text is not None:
        try:
            expressions.names(text)
        except expressions.ExpressionError as error:
            yield place, str(error)


CHECKS: dict[type[Any], Callable[[Any], Problems]] = {
    ElaboratorProgram: _elaborator_problems,
    BinderProgram: _binder_problems,
    AnalyzerProgram: _analyzer_problems,
}
