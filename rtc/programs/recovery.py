"""Choice of a trim by data: rules of an expert, and a search over pieces of script and events (R59, R86, R145). Pure.

Both are tables of the analyzer's program, so `rtc outcomes` shows their answers before anything fails. The analyzer
uses the same functions. A recovery is a list of entries of the trimming stack, and each is used once for a step.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from rtc.programs.schema import AnalyzerProgram, SearchModel, TrimRule
from rtc.protocol.messages import TrimOffer
from rtc.protocol.outcomes import StopReason

STACK, RULES, SEARCH = "stack", "rules", "search"
BUILT_IN = (STACK, RULES, SEARCH)
RESERVE = 1000  # entries above it are of `reserve`, not of the script or the sentence

Offers = Mapping[int, TrimOffer]  # entries that fit the failure and are unused, in their order


class Failure(NamedTuple):
    row: str  # of the analyzer's outcomes
    reason: StopReason
    failure: str  # class of the failure


def matching(program: AnalyzerProgram, failed: Failure, offers: Offers) -> Iterator[tuple[TrimRule, int]]:
    """The rules for this failure whose piece is on offer, each with its entry; their conditions on figures are open."""
    for rule in program.rules:
        wanted = ((rule.steps, failed.row), (rule.reasons, failed.reason), (rule.classes, failed.failure))
        entry = next((n for n, offer in offers.items() if offer.skill == rule.trim), 0)
        if entry and all(not names or name in names for names, name in wanted):
            yield rule, entry


def searched(model: SearchModel | None, reason: StopReason, offers: Offers) -> list[int]:
    """The shortest list of entries after which no condition is broken; empty if the finite search finds none.

    A state is the set of broken conditions. The reason breaks some; a piece needs some unbroken, and makes or breaks
    others. Among equals the order of the entries decides. An entry that gives up is no recovery."""
    if model is None or not (broken := frozenset(model.breaks.get(reason, ()))):
        return []
    able = {n: model.pieces[offer.skill] for n, offer in offers.items() if offer.skill in model.pieces}
    able = {n: piece for n, piece in able.items() if offers[n].then != "give_up"}
    waiting = deque([(broken, list[int]())])
    seen = {broken}
    while waiting:
        state, done = waiting.popleft()
        for n, piece in able.items():
            if n in done or state & {*piece.needs}:
                continue
            after = (state - {*piece.makes}) | {*piece.breaks}
            if not after:
                return [*done, n]
            if after not in seen and len(done) + 1 < model.most:
                seen.add(after)
                waiting.append((after, [*done, n]))
    return []
