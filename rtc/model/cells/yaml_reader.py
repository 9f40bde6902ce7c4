"""The one reader of YAML that people write: cells and programs. Numbers are those of YAML 1.2 (core schema). Pure.

The loader of PyYAML reads YAML 1.1, where `4e-2` is a text, `010` is 8 and `1:30` is 90. A number that is not finite
is refused, because no field of ours has a use for it. So is a document beyond the limits, before it is loaded: deep
nesting would overflow the C stack of the loader; nested aliases can expand to gigabytes.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable
from typing import Any

import msgspec
import yaml

from rtc.protocol.outcomes import ProgramError

MAX_DEPTH = 30  # maximum nesting of maps and lists; the default programs have 7 levels
MAX_NODES = 50_000  # maximum number of values in a document, with aliases expanded
BASES = {"0o": 8, "0x": 16}
TAG = "tag:yaml.org,2002:"
#: tag -> the plain scalars that have it, and their first characters; others are texts
CORE = {
    "null": (r"(?:~|null|Null|NULL|)", ["~", "n", "N", ""]),
    "bool": (r"(?:true|True|TRUE|false|False|FALSE)", list("tTfF")),
    "int": (r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)", list("-+0123456789")),
    "float": (
        r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))",
        list("-+.0123456789"),
    ),
    "merge": (r"<<", ["<"]),  # of YAML 1.1; cells use it
}


class Loader(yaml.CSafeLoader):
    """Constructs plain values. Its resolvers are those of the table `CORE` alone."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  the base class has a table of its own


def _int(loader: Loader, node: yaml.ScalarNode) -> int:
    text = str(loader.construct_scalar(node))
    return int(text, BASES.get(text[:2], 10))


def _float(loader: Loader, node: yaml.ScalarNode) -> float:
    text = str(loader.construct_scalar(node)).lower()
    value = float(text.replace(".inf", "inf").replace(".nan", "nan"))
    if not math.isfinite(value):
        raise ValueError("a finite number is expected")
    return value


def _number(construct: Callable[[Loader, yaml.ScalarNode], float]) -> Callable[[Loader, yaml.ScalarNode], float]:
    """The constructor of a number, with errors that know their place."""

    def constructed(loader: Loader, node: yaml.ScalarNode) -> float:
        try:
            return construct(loader, node)
        except ValueError as error:
            problem = f"{_short(str(node.value))}: {error}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from error

    return constructed


def _short(text: str) -> str:
    return text if len(text) <= 20 else f"{text[:17]}..."


for _tag, (_pattern, _first) in CORE.items():
    Loader.add_implicit_resolver(TAG + _tag, re.compile(f"{_pattern}$", re.ASCII), _first)
Loader.add_constructor(f"{TAG}int", _number(_int))
Loader.add_constructor(f"{TAG}float", _number(_float))


class Unreadable(ProgramError):
    """A value that cannot be read. `where`: its path, such as $.arms[0].payload_kg; `line`: from 1, 0 unknown."""

    def __init__(self, source: str, where: str, problem: str, line: int = 0) -> None:
        place = f"{source}, line {line}" if line else source
        super().__init__(f"{place}: {where}: {problem}" if where else f"{place}: {problem}")
        self.source, self.where, self.problem, self.line = source, where, problem, line


def read(text: bytes, source: str, most_nodes: int = MAX_NODES) -> Any:
    """The document in plain values; None if it is empty. Raises ProgramError with `source`, line and field."""
    if text.startswith(b"{"):
        with contextlib.suppress(msgspec.DecodeError, RecursionError):  # then it is YAML, or YAML knows the line
            return msgspec.json.decode(text)  # 20 times faster
    try:
        _check(text, source, most_nodes)
        return yaml.load(text, Loader)
    except yaml.MarkedYAMLError as error:
        where = _field(text, error) if isinstance(error, yaml.constructor.ConstructorError) else ""
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise Unreadable(source, where, str(error.problem or error.context), line) from error
    except (yaml.reader.ReaderError, UnicodeDecodeError) as error:
        raise Unreadable(source, "", f"it is not a text file in UTF-8: {error.reason}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise Unreadable(source, "", str(error)) from error


def nodes(text: bytes | str) -> yaml.Node | None:
    """The document as nodes, which know their lines. Raises yaml.YAMLError; a document that `read` reads has none."""
    return yaml.compose(text, Loader)


def _field(text: bytes, error: yaml.MarkedYAMLError) -> str:
    """The path of the value at the mark of an error, such as $.arms[0].payload_kg; or ''."""
    if error.problem_mark is None:
        return ""
    at, path = error.problem_mark.index, ""
    inner: tuple[str, yaml.Node | None] | None = ("$", nodes(text))
    while inner is not None:
        path, node = path + inner[0], inner[1]
        rows: list[tuple[str, yaml.Node]] = []
        if isinstance(node, yaml.MappingNode):
            rows = [(f".{key.value}", value) for key, value in node.value]
        elif isinstance(node, yaml.SequenceNode):
            rows = [(f"[{n}]", value) for n, value in enumerate(node.value)]
        inner = next((row for row in rows if row[1].start_mark.index <= at < row[1].end_mark.index), None)
    return path


def _check(text: bytes, source: str, most_nodes: int) -> None:
    """Raises ProgramError for a document beyond the limits, yaml.YAMLError for text that is not YAML."""
    sizes: dict[str, int] = {}  # anchor -> number of nodes it expands to
    open_nodes = [("", 0)]  # anchor, nodes so far
    for event in yaml.parse(text, Loader):
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
                raise ProgramError(f"{source}: the alias {event.anchor} has no anchor before it")
            nodes = sizes[event.anchor]
        outer, before = open_nodes[-1]
        open_nodes[-1] = (outer, before + nodes)
        if len(open_nodes) > MAX_DEPTH or before + nodes > most_nodes:
            what = (
                f"nested deeper than {MAX_DEPTH}" if len(open_nodes) > MAX_DEPTH else f"more than {most_nodes} values"
            )
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise ProgramError(f"{source}: line {line}: {what}")
