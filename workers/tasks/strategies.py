"""Strategies of a verb: its scripts, by the names of a sentence. Pure.

The script grasp-centering is GRASP-CENTERING, CENTERING-GRASP or CENTERING. One that VIA names is used alone. The fact
VERB-STRATEGY.default, which SET states, is the one that is tried first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from rtc.language.dictionary import reserved_words
from rtc.programs.schema import Branch, ElaboratorProgram, ScriptFile
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import OPERATOR, ParsedCommand
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery

STRATEGY, DEFAULT = "-STRATEGY", "DEFAULT"


def is_strategy(name: str, verb: str, script: str) -> bool:
    """Whether a name of a sentence is that of a script: the same words in any order, with or without the verb."""
    own = set(script.upper().split("-"))
    return set(name.split("-")) in (own, own - {verb}, own | {verb})


def names(branches: Sequence[Branch]) -> list[str]:
    """The names of the scripts of these rows, as a sentence has them; a reserved word cannot be one."""
    every = dict.fromkeys(branch.script.upper() for branch in branches)
    return [name for name in every if name not in reserved_words()]


def via(
    program: ElaboratorProgram,
    scripts: Mapping[str, ScriptFile],
    parsed: ParsedCommand,
    branches: list[Branch],
    query: WorldQuery,
) -> tuple[ParsedCommand, list[Branch]]:
    """The rows that VIA leaves, and the sentence without a VIA that has named one. Raises Refused.

    Of scripts with a camera VIA may name that. Without VIA the row of the default strategy comes first."""
    wanted = parsed.performer
    if wanted is None:
        own = [branch for branch in branches if not branch.by_operator] or branches
        return parsed, _default_first(parsed, own, query)
    if wanted == OPERATOR:
        return parsed, _by_operator(program, parsed, branches)
    by_row = any(check.equals.get("performer") == wanted for branch in branches for check in branch.when)
    if by_row or any("camera" in scripts[branch.script].resources for branch in branches):
        return parsed, branches
    chosen = [branch for branch in branches if is_strategy(wanted, parsed.verb, branch.script)]
    if not chosen:
        by = [name for row in branches for check in row.when if (name := check.equals.get("performer"))]
        known = [*names(branches), *(f"{OPERATOR}-INTERVENTION" if name == OPERATOR else name for name in by)]
        raise suggestions.unknown(f"{parsed.verb} strategy", wanted, known)
    return msgspec.structs.replace(parsed, performer=None), chosen


def _by_operator(program: ElaboratorProgram, parsed: ParsedCommand, branches: list[Branch]) -> list[Branch]:
    """The rows for the operator. Raises Refused."""
    chosen = [branch for branch in branches if branch.by_operator]
    if chosen:
        return chosen
    verbs = list(dict.fromkeys(row.verb for row in program.decision_tree if row.by_operator))
    message = f"there is no script in which the operator performs {parsed.verb}"
    clears = f"leave out VIA; the operator performs {', '.join(verbs)}"
    raise Refused.because(RefusalReason.NO_SCRIPT, message, where="performer", expected=verbs, clears=clears)


def _default_first(parsed: ParsedCommand, branches: list[Branch], query: WorldQuery) -> list[Branch]:
    default = query.world.value(f"{parsed.verb}{STRATEGY}.{DEFAULT.lower()}")
    if not isinstance(default, str):
        return branches
    first = [b for b in branches if is_strategy(default, parsed.verb, b.script)]
    others = [b for b in branches if b not in first]
    return [*(msgspec.structs.replace(b, likelihood=1.0) for b in first), *others]


def refused(parsed: ParsedCommand, others: list[str]) -> Refused:
    """The refusal of a strategy that does not fit the object and the hand as they are."""
    message = f"{parsed.verb} VIA {parsed.performer}: this strategy does not fit {parsed.object or 'this'} now"
    clears = by_person("leave out VIA", *(f"VIA {name}" for name in others))
    return Refused.because(RefusalReason.NO_SCRIPT, message, where="performer", expected=others, clears=clears)
