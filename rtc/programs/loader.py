"""Worker programs: read from files, checked, merged by LOAD, encoded canonically.

The program of the parser is its grammar. The other programs are documents of `rtc.programs.schema`, stored as YAML
files under `programs/KIND/`. Each file holds sections of one document. A file in `scripts/` or `pieces/` holds one item
and may add its own table rows, so that one file can add a skill. The canonical form is JSON with sorted keys, so that
equal programs have equal digests. Each fault raises a ProgramError that names the place.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from rtc.language.grammar import Grammar
from rtc.model.cells import yaml_reader
from rtc.programs import checks, plugin_fields
from rtc.programs.compatibility import misfits
from rtc.programs.schema import (
    AnalyzerProgram,
    BinderProgram,
    ElaboratorProgram,
    Program,
)
from rtc.programs.yaml_location import known_keys, line_of, line_of_key, path_of
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError

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
#: the name of a trimming stack in the paper's Figure 4, which a script may use too (A10)
STACK, PAPERS_STACK = "trimming_stack", "trail_stack"
#: further sections that a file with a single item may have
BESIDE_ITEMS = ("settable",)

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


@lru_cache(maxsize=8)
def parts(kind: WorkerKind | str) -> dict[str, Path]:
    """The files of the delivered program of a kind, by the names that a sentence may give them: that of the file, and
    those of the scripts and pieces in it."""
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return {"GRAMMAR": GRAMMAR}
    named: dict[str, Path] = {}
    for path in sorted((PROGRAMS / kind.value).rglob("*.yaml")):
        document = _read(path.read_bytes(), path.name)
        items = [document, *(document.get("scripts") or ()), *(document.get("pieces") or ())]
        own = [item[field] for item in items for field in ITEMS if isinstance(item.get(field), str)]
        named |= {name.upper().replace("_", "-"): path for name in (path.stem, *own)}
    return named


def part(kind: WorkerKind | str, name: str) -> Path | None:
    """The file of a part by its name, whose words may have any order: CENTERING-GRASP is grasp-centering."""
    words = sorted(name.removesuffix("-SCRIPT").split("-"))  # LIFT-SCRIPT, because LIFT is a reserved word
    return next((path for known, path in parts(kind).items() if sorted(known.split("-")) == words), None)


def merge(
    kind: WorkerKind | str, program: bytes, name: str, text: bytes, others: Mapping[WorkerKind, bytes] | None = None
) -> bytes:
    """The program with the document `text` of the file `name` merged in; items of the same identity are replaced.

    `others`: the programs of the other kinds; with them, compatibility is checked. Raises ProgramError with the line.
    """
    kind = WorkerKind(kind)
    if kind is WorkerKind.PARSER:
        return _grammar(_extended(program, name, text), name)
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


def whole(kind: WorkerKind | str, others: Mapping[WorkerKind, bytes], earlier: bytes = b"") -> bytes:
    """An earlier program of a kind, or the default one. Raises ProgramError if it is incompatible with the `others`."""
    kind = WorkerKind(kind)
    body = earlier or default(kind)
    if kind is not WorkerKind.PARSER:
        name = f"the {'earlier' if earlier else 'default'} {kind} program"
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
    document = yaml_reader.read(text, source)
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


def _put(whole: dict[str, Any], document: dict[str, Any], source: str) -> None:
    """Merges the sections of a document into `whole`, in place. Raises ProgramError."""
    for field, section in ITEMS.items():
        if isinstance(document.get(field), str):
            tables = {key: document[key] for key in (*IDENTITY, *BESIDE_ITEMS) if key in document}
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
    if section == "scripts":
        news = [_with_one_stack(item, source) for item in news]
    return list((_by_identity(items, section) | _by_identity(news, section)).values())


def _with_one_stack(script: dict[str, Any], source: str) -> dict[str, Any]:
    if PAPERS_STACK not in script:
        return script
    if STACK in script:
        raise ProgramError(f"{source}: {script.get('script')} has {STACK} and {PAPERS_STACK}: they are the same list")
    return {STACK if key == PAPERS_STACK else key: value for key, value in script.items()}


def _by_identity(items: list[dict[str, Any]], section: str) -> dict[tuple[str, ...], dict[str, Any]]:
    return {tuple(str(item.get(field) or "") for field in IDENTITY[section]): item for item in items}


def _canonical(kind: WorkerKind, document: dict[str, Any], source: str) -> bytes:
    return msgspec.json.encode(_checked(document, SCHEMAS[kind], source), order="deterministic")


def _extended(grammar: bytes, name: str, text: bytes) -> bytes:
    """A text that begins with %extend, added to the grammar in place of what the file of that name added before; any
    other text is a whole grammar."""
    lines = (line.strip() for line in text.splitlines())
    if not next((line for line in lines if line and not line.startswith(b"//")), b"").startswith(b"%extend"):
        return text
    begin, end = (f"// {word} {name}\n".encode() for word in ("added by", "end of"))
    kept = re.sub(re.escape(begin) + b".*?" + re.escape(end), b"", grammar, flags=re.DOTALL)
    return b"\n".join([kept.rstrip(b"\n"), begin + text.strip(b"\n"), end])


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
        program = msgspec.convert(plugin_fields.gathered(document), schema, strict=True)
    except msgspec.ValidationError as error:
        raise ProgramError(f"{source}: {error}{_owner(document, str(error))}") from error
    for place, problem in checks.CHECKS[schema](program):
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
