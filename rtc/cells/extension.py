"""A cell file that extends another: `extends: swapout`, and what differs from it. Pure but for reading the files.

Parts of a list with the same name (tags: the same id) are merged field by field; others are added. Everything else
that the file states replaces what the other one has.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import msgspec.yaml

from rtc.protocol.outcomes import ProgramError

DEEPEST = 4  # maximum number of files that extend each other

Document = dict[str, Any]


def read(path: Path, find: Callable[[str, Path], Path], depth: int = 0) -> tuple[Document, list[Path]]:
    """The merged document of a cell file, and the folders of its models, its own first. Raises ProgramError.

    `find`: the file of the cell that another one names, relative to its folder.
    """
    if depth == DEEPEST:
        raise ProgramError(f"{path}: $.extends: more than {DEEPEST} cells extend each other")
    try:
        own = msgspec.yaml.decode(path.read_bytes(), type=Document)
    except msgspec.MsgspecError as error:
        raise ProgramError(f"{path}: {error}") from error
    extended = own.pop("extends", None)
    if extended is None:
        return own, [path.parent]
    if not isinstance(extended, str):
        raise ProgramError(f"{path}: $.extends: the name or the file of a cell is wanted")
    base, folders = read(find(extended, path.parent), find, depth + 1)
    return {key: _merged(base.get(key), own.get(key)) for key in {**base, **own}}, [path.parent, *folders]


def _merged(old: Any, new: Any) -> Any:
    if new is None:
        return old
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
