"""One file for several kinds of worker: a map with a section for each, such as a whole verb (docs/scripts.md). Pure.

The section of the parser is a text: a grammar, or rows for it (%extend). The others are program documents.
"""

from __future__ import annotations

import textwrap

import yaml

from rtc.model.cells import yaml_reader
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError

#: a script needs the stop classes and rows that it names, and a verb of the grammar
ORDER = (WorkerKind.PARSER, WorkerKind.BINDER, WorkerKind.ANALYZER, WorkerKind.ELABORATOR)


def sections(text: bytes, name: str) -> dict[WorkerKind, bytes]:
    """The part for each kind, in the order of loading. Lines keep their numbers. Raises ProgramError."""
    try:
        words = text.decode()
    except UnicodeDecodeError as error:
        raise ProgramError(f"{name}: {error}") from error
    yaml_reader.read(text, name)
    root = yaml_reader.nodes(words)
    rows = root.value if isinstance(root, yaml.MappingNode) else []
    found = {key.value: value for key, value in rows}
    unknown = [key for key in found if key not in list(WorkerKind)]
    if not found or unknown:
        kinds = ", ".join(WorkerKind)
        what = f"{unknown[0]} is none" if found else "it has none"
        raise ProgramError(f"{name}: a file without INTO KIND has a section for each kind ({kinds}); {what}")
    return {kind: _part(words, found[kind], kind) for kind in ORDER if kind in found}


def _part(words: str, node: yaml.Node, kind: WorkerKind) -> bytes:
    if kind is WorkerKind.PARSER:
        return str(node.value).encode()
    start, end = node.start_mark, node.end_mark
    part = " " * start.column + words[start.index : end.index]
    lines = "\n" * start.line or " "  # a document that begins with a brace would be JSON
    return (lines + textwrap.dedent(part)).encode()
