"""Limits of a YAML document, checked by its parse events before it is loaded. Pure.

Deep nesting would overflow the C stack of the loader; nested aliases can expand to gigabytes.
"""

from __future__ import annotations

import yaml

from rtc.protocol.outcomes import ProgramError

MAX_DEPTH = 30  # maximum nesting of maps and lists; the default programs have 7 levels
MAX_NODES = 50_000  # maximum number of values in a document, with aliases expanded


def check(text: bytes, source: str, most_nodes: int = MAX_NODES) -> None:
    """Raises ProgramError for a document beyond the limits, yaml.YAMLError for text that is not YAML."""
    sizes: dict[str, int] = {}  # anchor -> number of nodes it expands to
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
