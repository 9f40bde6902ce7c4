"""Fields of programs for installed packages (R144): keys that begin with `x-`, in branches and steps. Pure.

rtc passes them on unread: those of a branch to evaluators, those of a step to trimmers, phases and mechanisms. In the
typed document they stand together in `extra`. Any other unknown key is an error, so a misspelt key is found.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rtc.plugins import registry
from rtc.programs.schema import ElaboratorProgram

MARK = "x-"
EXTRA = "extra"


def gathered(document: dict[str, Any]) -> dict[str, Any]:
    """The document with the `x-` keys of its branches and steps in `extra`. Its other parts are the same objects."""
    found = dict(document)
    if "decision_tree" in found:
        found["decision_tree"] = _of_items(found["decision_tree"])
    for section in ("scripts", "pieces"):
        if isinstance(items := found.get(section), list):
            found[section] = [_of_script(item) for item in items]
    return found


def _of_script(item: Any) -> Any:
    return {**item, "steps": _of_items(item["steps"])} if isinstance(item, dict) and "steps" in item else item


def _of_items(items: Any) -> Any:
    return [_of_item(item) for item in items] if isinstance(items, list) else items


def _of_item(item: Any) -> Any:
    marked = [key for key in item if key.startswith(MARK)] if isinstance(item, dict) else []
    if not marked:
        return item
    rest = {key: value for key, value in item.items() if key not in marked}
    return {**rest, EXTRA: {**item.get(EXTRA, {}), **{key: item[key] for key in marked}}}


def problems(program: ElaboratorProgram) -> Iterator[tuple[str, str]]:
    """(place, problem): fields that no installed package could read, or that only rtc writes."""
    branches = [(f"decision_tree[{n}]", row.extra) for n, row in enumerate(program.decision_tree)]
    lists = {f"scripts[{n}]": script.steps for n, script in enumerate(program.scripts)}
    lists |= {f"pieces[{n}]": piece.steps for n, piece in enumerate(program.pieces)}
    steps = [(f"{at}.steps[{m}]", step.extra) for at, each in lists.items() for m, step in enumerate(each)]
    of_steps = (registry.TRIMMERS, registry.PHASES, registry.MECHANISMS)
    for groups, placed in (((registry.EVALUATORS,), branches), (of_steps, steps)):
        used = [(place, extra) for place, extra in placed if extra]
        if used and not any(map(registry.names, groups)):
            place, extra = used[0]
            yield place, f"{next(iter(extra))} is for {' or '.join(groups)}, and no package of that is installed"
        for place, extra in used:
            yield from ((place, f"{key} does not begin with {MARK}") for key in extra if not key.startswith(MARK))
