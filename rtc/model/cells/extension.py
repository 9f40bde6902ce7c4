"""A cell file that extends another: `extends: swapout`, and what differs from it. Pure but for reading the files.

Parts of a list with the same name (tags: the same id) are merged field by field; others are added. An empty
list leaves out all of its parts. Everything else that the file states replaces what the other one has.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rtc.model.cells import yaml_reader
from rtc.protocol.outcomes import ProgramError

DEEPEST = 4  # maximum number of files that extend each other
MAX_VALUES = 1_000_000  # maximum number of values in a cell file, with aliases expanded

Document = dict[str, Any]


def read(path: Path, find: Callable[[str, Path], Path], depth: int = 0) -> tuple[Document, list[Path]]:
    """The merged document of a cell file, and the folders of its models, its own first. Raises ProgramError.

    `find`: the file of the cell that another one names, relative to its folder.
    """
    if depth == DEEPEST:
        raise ProgramError(f"{path}: $.extends: more than {DEEPEST} cells extend each other")
    own = document_of(path.read_bytes(), str(path))
    if not isinstance(own, dict):
        raise ProgramError(f"{path}: $: a cell is a map")
    extended = own.pop("extends", None)
    if extended is None:
        return own, [path.parent]
    if not isinstance(extended, str):
        raise ProgramError(f"{path}: $.extends: the name or the file of a cell is wanted")
    base, folders = read(find(extended, path.parent), find, depth + 1)
    return {key: _merged(base.get(key), own.get(key)) for key in {**base, **own}}, [path.parent, *folders]


def document_of(text: bytes, source: str) -> Any:
    """The plain values of a cell file. Raises ProgramError."""
    return yaml_reader.read(text, source, MAX_VALUES)


def _merged(old: Any, new: Any) -> Any:
    if new is None:
        return old
    if new == []:  # nothing of it
        return new
    if isinstance(old, dict) and isinstance(new, dict):
        return {**old, **new}
    if not isinstance(old, list) or not isinstance(new, list):
        return new
    changes = {_key(part): part for part in new if _key(part) is not None}
    known = {_key(part) for part in old}
    kept = [{**part, **changes.get(_key(part), {})} if isinstance(part, dict) else part for part in old]
    return [*kept, *(part for part in new if _key(part) is None or _key(part) not in known)]


def _key(part: Any) -> Any:
    return part.get("name", part.get("id")) if isinstance(part, dict) else None
