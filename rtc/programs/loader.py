"""Worker programs: read from files, checked, merged by LOAD, encoded canonically.

The program of the parser is its grammar. The other programs are documents of `rtc.programs.schema`, stored as YAML
files under `programs/KIND/`. Each file holds sections of one document. A file in `scripts/` or `pieces/` holds one item
and may add its own table rows, so that one file can add a skill. The canonical form is JSON with sorted keys, so that
equal programs have equal digests. Each fault raises a ProgramError that names the place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from rtc.language.alike import unknown
from rtc.language.grammar import Grammar
from rtc.model.cells import yaml_limits
from rtc.programs import checks, expressions, extension_names
from rtc.programs.compatibility import Problems, misfits
from rtc.programs.schema import (
    AnalyzerProgram,
    BinderProgram,
    ElaboratorProgram,
    Program,
    ScriptFile,
    ScriptStep,
    StopRow,
)
from rtc.programs.yaml_location import known_keys, line_of, line_of_key, path_of
from rtc.protocol.messages import Limits, WorkerKind
from rtc.protocol.outcomes import ProgramError, Reflex, StopReason

PROGRAMS = Path(__file__).parent / "default"
GRAMMAR = Path(__file__).parents[1] / "language" / "command.lark"

SCHEMAS: dict[WorkerKind, type[Program]] = {
    WorkerKind.ELABORATOR: ElaboratorProgram,
    WorkerKind.BINDER: BinderProgram,
    WorkerKind.ANALYZER: AnalyzerProgram,
}
#: list section -> the identifying fields; LOAD replaces an item of the same identity
IDENTITY: dict[str, tuple[str, ...]] = {
    "scripts": ("script",),
    "pieces": ("skill",),
    "decision_tree": ("verb", "script"),
    "command_object_table": ("verb", "kind", "name"),
}
#: field that marks a document as a single item -> its section
ITEMS: dict[str, str] = {"script": "scripts", "skill": "pieces"}

_EXPECTED = "a program document is a map of sections, such as " + "; ".join(
    f"for the {kind.value} {', '.join(sorted(schema.__struct_fields__)[:3])}" for kind, schema in SCHEMAS.items()
)

P = TypeVar("P", bound=Program)


@lru_cache(maxsize=8)
def default(kind: WorkerKind | str) -> bytes:
    """The default program of a kind of worker, from the files of this package. Raises ProgramError."""
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return GRAMMAR.read_bytes()
    document: dict[str, Any] = {}
    folder = PROGRAMS / kind.value
    for path in sorted(folder.rglob("*.yaml")):
        _put(document, _read(path.read_bytes(), str(path.relative_to(PROGRAMS))), str(path.relative_to(PROGRAMS)))
    return _canonical(kind, document, str(folder.relative_to(PROGRAMS.parent)))


def merge(
    kind: WorkerKind | str, program: bytes, name: str, text: bytes, others: Mapping[WorkerKind, bytes] | None = None
) -> bytes:
    """The program with the document `text` of the file `name` merged in; items of the same identity are replaced.

    `others`: the programs of the other kinds; with them, compatibility is checked. Raises ProgramError with the line.
    """
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return _grammar(text, name)
    document, news = _read(program, f"the {kind} program in use"), _read(text, name)
    _of_this_kind(kind, news, name, text)
    _put(document, news, name)
    try:
        merged = _canonical(kind, document, name)
        _fits({**(others or {}), kind: merged}, kind, document, name)
    except ProgramError as error:
        stray = re.search(r"unknown field `(.*?)`", str(error))
        path = _in_file([*path_of(str(error)), *stray.groups()] if stray else path_of(str(error)), document, news)
        if path is None or text.startswith(b"{"):
            raise
        complaint = str(error).removeprefix(f"{name}: ")
        if stray and (known := known_keys(SCHEMAS[kind], path_of(str(error)))):
            complaint += f"; the keys are {', '.join(known)}"
        line = line_of_key(text, path) if stray else line_of(text, path)
        raise ProgramError(f"{name}, line {line}: {complaint}") from error
    return merged


def original(kind: WorkerKind | str, others: Mapping[WorkerKind, bytes]) -> bytes:
    """The default program of a kind. Raises ProgramError when it is incompatible with the `others` in use."""
    kind, body = WorkerKind(kind), default(kind)
    if kind is not WorkerKind.PARSER:
        name = f"the default {kind} program"
        _fits({**others, kind: body}, kind, _read(body, name), name)
    return body


def changes(kind: WorkerKind | str, before: bytes, after: bytes) -> list[str]:
    """The changes between two programs, one line per item: "scripts: grasp-gentle is new".

    A changed script without a row in the decision tree gets a further line, because no verb would select it.
    """
    if WorkerKind(kind) is WorkerKind.PARSER:
        return [] if before == after else ["the grammar is changed"]
    old, new = _items(_read(before, "the program in use")), _items(_read(after, "the new program"))
    lines = [f"{name} is {'changed' if name in old else 'new'}" for name, item in new.items() if old.get(name) != item]
    chosen = {row["script"] for name, row in new.items() if name.startswith("decision_tree:")}
    lines += [f"{name} is removed" for name in old if name not in new]
    for name, item in new.items():
        if name.startswith("scripts:") and item["script"] not in chosen and old.get(name) != item:
            row = f"decision_tree: [{{verb: VERB, script: {item['script']}}}]"
            lines.append(f"no verb selects {item['script']}; add to the file: {row}")
    return lines


def _items(document: dict[str, Any]) -> dict[str, Any]:
    """The items that LOAD can replace separately, by name: "scripts: lift", "stop_classes: move_free"."""
    items: dict[str, Any] = {}
    for section, content in document.items():
        if section in IDENTITY:
            named = _by_identity(content, section)
            found = {" ".join(part or "any" for part in identity): item for identity, item in named.items()}
        elif isinstance(content, dict):
            found = content
        else:
            items[section] = content
            continue
        items |= {f"{section}: {name}": item for name, item in found.items()}
    return items


def decode(program: bytes, schema: type[P]) -> P:
    """The typed document of a canonical program, checked. Takes some ms: cache it by digest. Raises ProgramError."""
    return _checked(_read(program, "the program"), schema, "the program")


# --- reading and merging ------------------------------------------------------------------------


def _read(text: bytes, source: str) -> dict[str, Any]:
    try:
        document = msgspec.json.decode(text) if text.startswith(b"{") else _yaml(text, source)
    except yaml.MarkedYAMLError as error:
        at = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ProgramError(f"{source}{at}: {error.problem or error.context}") from error
    except (yaml.reader.ReaderError, UnicodeDecodeError) as error:
        raise ProgramError(f"{source}: it is not a text file in UTF-8: {error.reason}") from error
    except (yaml.YAMLError, msgspec.DecodeError, RecursionError, ValueError) as error:
        raise ProgramError(f"{source}: {error}") from error
    if document is None:
        raise ProgramError(f"{source}: the file is empty; {_EXPECTED}")
    if not isinstance(document, dict) or not all(isinstance(key, str) for key in document):
        raise ProgramError(f"{source}: $: a program document is a map of sections, not {type(document).__name__}")
    return document


def _of_this_kind(kind: WorkerKind, news: dict[str, Any], name: str, text: bytes) -> None:
    """Raises ProgramError for a section that programs of this kind lack, such as a script for the binder."""
    sections = [field.name for field in msgspec.structs.fields(SCHEMAS[kind])]
    item = next((field for field in ITEMS if isinstance(news.get(field), str)), "")
    wrong = item if item and ITEMS[item] not in sections else ""
    if not item:
        wrong = next((section for section in news if section not in sections), "")
    if not wrong:
        return
    known = ", ".join(sorted(sections))
    line = "" if text.startswith(b"{") else f", line {line_of(text, [wrong])}"
    owner = next((k.value for k, s in SCHEMAS.items() if ITEMS.get(wrong, wrong) in s.__struct_fields__), "")
    goes = f"; a {wrong} goes INTO {owner}; a {kind.value} program has {known}" if owner else f"; it has {known}"
    raise ProgramError(f"{name}{line}: a {kind.value} program has no section {ITEMS.get(wrong, wrong)}{goes}")


def _yaml(text: bytes, source: str) -> Any:
    """The document, after a check of its size. Raises ProgramError, yaml.YAMLError."""
    yaml_limits.check(text, source)
    return yaml.load(text, yaml.CSafeLoader)


def _put(whole: dict[str, Any], document: dict[str, Any], source: str) -> None:
    """Merges the sections of a document into `whole`, in place. Raises ProgramError."""
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

    return list((_by_identity(items, section) | _by_identity(news, section)).values())


def _by_identity(items: list[dict[str, Any]], section: str) -> dict[tuple[str, ...], dict[str, Any]]:
    return {tuple(str(item.get(field) or "") for field in IDENTITY[section]): item for item in items}


def _canonical(kind: WorkerKind, document: dict[str, Any], source: str) -> bytes:
    return msgspec.json.encode(_checked(document, SCHEMAS[kind], source), order="deterministic")


def _grammar(text: bytes, source: str) -> bytes:
    try:
        Grammar(text.decode())
    except (ProgramError, UnicodeDecodeError) as error:
        raise ProgramError(f"{source}: {error}") from error
    return text


def _in_file(path: list[str | int], whole: dict[str, Any], news: dict[str, Any]) -> list[str | int] | None:
    """The path in the merged file for a path in the whole program; None if the value is not from that file."""
    section, *rest = path or [""]
    if section not in IDENTITY or not rest:
        return path if section in news else None
    item = whole[section][rest[0]]
    single = next((field for field, of in ITEMS.items() if of == section and isinstance(news.get(field), str)), "")
    if single:
        return rest[1:] if item.get(single) == news[single] else None
    mine = news.get(section, [])
    return next(([section, n, *rest[1:]] for n, one in enumerate(mine) if one is item), None)


# --- checks beyond the types ----------------------------------------------------------------


def _checked(document: dict[str, Any], schema: type[P], source: str) -> P:
    try:
        program = msgspec.convert(document, schema, strict=True)
    except msgspec.ValidationError as error:
        raise ProgramError(f"{source}: {error}{_owner(document, str(error))}") from error
    for place, problem in CHECKS[schema](program):
        raise ProgramError(f"{source}: $.{place}: {problem}{_owner(document, place)}")
    return program


def _owner(document: dict[str, Any], place: str) -> str:
    """The name of the script or piece that contains a place like `scripts[3].steps[2]`, in brackets."""
    found = re.search(r"(scripts|pieces)\[(\d+)\]", place)
    if not found:
        return ""
    item = document[found[1]][int(found[2])]
    return f" (in {item.get('script') or item.get('skill') or 'unnamed'})" if isinstance(item, dict) else ""


def _fits(programs: Mapping[WorkerKind, bytes], kind: WorkerKind, document: dict[str, Any], source: str) -> None:
    """Raises ProgramError unless the given programs are compatible; `programs` may lack some kinds."""
    if kind is WorkerKind.ELABORATOR and (grammar := programs.get(WorkerKind.PARSER)) is not None:
        typed = msgspec.json.decode(programs[kind], type=ElaboratorProgram)
        for place, problem in checks.unknown_verbs(typed, grammar.decode()):
            raise ProgramError(f"{source}: $.{place}: {problem}")
    if not programs.keys() >= SCHEMAS.keys():
        return
    elaborator = msgspec.json.decode(programs[WorkerKind.ELABORATOR], type=ElaboratorProgram)
    binder = msgspec.json.decode(programs[WorkerKind.BINDER], type=BinderProgram)
    analyzer = msgspec.json.decode(programs[WorkerKind.ANALYZER], type=AnalyzerProgram)
    for place, problem in misfits(elaborator, binder, analyzer):
        if kind is WorkerKind.ELABORATOR:
            raise ProgramError(f"{source}: $.{place}: {problem}{_owner(document, place)}")
        raise ProgramError(f"{source}: it is incompatible with the elaborator's program: {place}: {problem}")


def _elaborator_problems(program: ElaboratorProgram) -> Problems:
    scripts = {script.script for script in program.scripts}
    for n, branch in enumerate(program.decision_tree):
        if branch.script not in scripts:
            yield f"decision_tree[{n}].script", unknown("script", branch.script, scripts)
        for m, check in enumerate(branch.when):
            for field in ("of", "at_least", "at_most"):
                yield from _expression(getattr(check, field), f"decision_tree[{n}].when[{m}].{field}")
    for slot, units in program.constraints.items():
        for unit, limit in units.items():
            if limit and limit not in Limits.__struct_fields__:
                yield f"constraints.{slot}.{unit}", unknown("limit", limit, Limits.__struct_fields__)
    for figure, most in program.by_hand.items():
        yield from _known("figure of the hand", most, set(extension_names.HAND_LIMITS), f"by_hand.{figure}")
    pieces = {piece.skill for piece in program.pieces}
    for attribute, skill in program.senses.items():
        yield from _known("piece", skill, pieces, f"senses.{attribute}")
    yield from _figure_problems(program)
    yield from checks.problems(program)
    for n, script in enumerate(program.scripts):
        yield from _script_problems(script, f"scripts[{n}]")
    for n, piece in enumerate(program.pieces):
        for m, step in enumerate(piece.steps):
            yield from _step_problems(step, f"pieces[{n}].steps[{m}]", entries=0, bindings=None)


def _figure_problems(program: ElaboratorProgram) -> Problems:
    """Names in expressions without a value in the cell, the command-object table or a sentence."""
    known = {*extension_names.FIGURES, *(name for row in program.command_object_table for name in row.values)}
    sums: dict[str, str | float] = {}
    for n, script in enumerate(program.scripts):
        sums |= {f"scripts[{n}].plan[{m}].by": line.by for m, line in enumerate(script.plan)}
    steps = {f"scripts[{n}]": script.steps for n, script in enumerate(program.scripts)}
    steps |= {f"pieces[{n}]": piece.steps for n, piece in enumerate(program.pieces)}
    for item, lines in steps.items():
        for n, step in enumerate(lines):
            sums |= {f"{item}.steps[{n}].args.{name}": value for name, value in step.args.items()}
    for place, expression in sums.items():
        for name in sorted(_names(expression)):
            yield from _known("figure", name, known, place)


def _names(expression: str | float) -> set[str]:
    try:
        return set(expressions.names(expression))
    except expressions.ExpressionError:
        return set()  # reported by the check of that expression


def _script_problems(script: ScriptFile, place: str) -> Problems:
    for n, need in enumerate(script.needs):
        yield from _known("condition of the world", need, extension_names.NEEDS, f"{place}.needs[{n}]")
    if script.unsure_if is not None:
        for field in ("of", "at_least", "at_most"):
            yield from _expression(getattr(script.unsure_if, field), f"{place}.unsure_if.{field}")
    planned: set[str] = set()
    for n, line in enumerate(script.plan):
        yield from _known("anchor", line.at, [*extension_names.ANCHORS, *sorted(planned)], f"{place}.plan[{n}].at")
        if line.along:
            yield from _known("axis", line.along, extension_names.PLAN_AXES, f"{place}.plan[{n}].along")
        yield from _expression(line.by, f"{place}.plan[{n}].by")
        if line.near and line.near not in planned:
            yield f"{place}.plan[{n}].near", f"no earlier line {line.near}"
        planned.add(line.name)
    for n, entry in enumerate(script.trimming_stack):
        if entry.n != n + 1:
            yield f"{place}.trimming_stack[{n}].n", f"entries are numbered in order from 1; this is number {n + 1}"
    if script.trimming_stack and script.case < 3:
        yield f"{place}.trimming_stack", "actions (cases 1 and 2) cannot be trimmed"
    bindings = planned | {step.name for step in script.steps if step.do == "let"}
    for n, step in enumerate(script.steps):
        yield from _step_problems(step, f"{place}.steps[{n}]", len(script.trimming_stack), bindings)


def _step_problems(step: ScriptStep, place: str, entries: int, bindings: set[str] | None) -> Problems:
    index, count = step.trim
    if (index, count) != (0, 0) and not (index >= 1 and count >= 1 and index + count - 1 <= entries):
        yield f"{place}.trim", f"[index, count] = [{index}, {count}] is outside the trimming stack of {entries} entries"
    if bindings is not None and step.to and step.to != "HERE" and step.to not in bindings:
        yield f"{place}.to", unknown("binding", step.to, bindings)
    yield from _known("performer", step.who, extension_names.PERFORMERS, f"{place}.who")
    if step.space or step.to:
        yield from _known("space", step.space or "(none)", extension_names.SPACES, f"{place}.space")
    for name, source in step.keep.items():
        yield from _known("measured value", source, extension_names.KEPT, f"{place}.keep.{name}")
    for word in ("effect", "missed"):
        if effect := step.words.get(word):
            yield from _known("effect", effect, extension_names.EFFECTS, f"{place}.words.{word}")
    if "{" not in (axis := step.words.get("axis", "X")):
        yield from _known("axis", axis, extension_names.PLAN_AXES, f"{place}.words.axis")
    for name, expression in step.args.items():
        yield from _expression(expression, f"{place}.args.{name}")
    if step.value:
        yield from _expression(step.value, f"{place}.value")
        for name in sorted(expressions.names(step.value) - bindings) if bindings is not None else ():
            yield f"{place}.value", unknown("binding", name, bindings or ())


def _binder_problems(program: BinderProgram) -> Problems:
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
        if name not in program.stop_classes:
            yield f"hand.{op}", unknown("stop class", name, program.stop_classes)
    for do, action in program.actions.items():
        yield from _known("action", action, extension_names.ACTIONS, f"actions.{do}")
    for name, procedure in program.procedures.items():
        yield from _known("procedure", procedure, extension_names.PROCEDURES, f"procedures.{name}")
    for n, stop in enumerate(program.holding):
        yield from _stop_row(stop, f"holding[{n}]")


def _stop_row(stop: StopRow, where: str) -> Problems:
    yield from _known("predicate", stop.when, extension_names.PREDICATES, f"{where}.when")
    yield from _expression(stop.limit, f"{where}.limit")
    if (stop.reflex is Reflex.BACK_OFF) is not (stop.back_off_m > 0.0):
        yield f"{where}.back_off_m", "a distance above 0 goes with the reflex back_off, and with no other"


def _analyzer_problems(program: AnalyzerProgram) -> Problems:
    yield from checks.failure_words(program)
    for row, cells in program.outcomes.items():
        missing = [reason.value for reason in StopReason if reason not in cells]
        if missing:
            yield f"outcomes.{row}", f"no cell for {', '.join(missing)}"
        for reason, name in cells.items():
            if name not in program.classes:
                yield f"outcomes.{row}.{reason}", unknown("class", name, program.classes)


def _known(what: str, name: str, known: Collection[str], place: str) -> Problems:
    if name not in known:
        yield place, unknown(what, name, known)


def _values(values: dict[str, str | float], place: str) -> Problems:
    for name, expression in values.items():
        yield from _expression(expression, f"{place}.{name}")


def _expression(text: str | float | None, place: str) -> Problems:
    if text is not None:
        try:
            if problem := checks.valueless(str(text)):
                yield place, problem
        except expressions.ExpressionError as error:
            yield place, str(error)


CHECKS: dict[type[Any], Callable[[Any], Problems]] = {
    ElaboratorProgram: _elaborator_problems,
    BinderProgram: _binder_problems,
    AnalyzerProgram: _analyzer_problems,
}
