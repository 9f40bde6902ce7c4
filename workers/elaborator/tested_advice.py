"""The advice of a refusal, without the sentences that would be refused themselves. Pure.

An advice has steps, and a step has alternatives. Tested is what can be given now: the first sentence of a step, while
no step before it has one. Left out is what has no way: what is out of reach, say. A sentence that is refused for a
state or a doubt stays, because its own refusal leads on. Another arm is named, or left out if none can do it.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import msgspec

from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import IN_THE_WAY, Refusal, RefusalReason
from rtc.protocol.sentence import OPERATOR, ParsedCommand

TESTED = 6  # maximum number of sentences of an advice that are tested
ABOUT = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.SUSPECT)
STEP, OR = "; ", ", or "
SENTENCE = re.compile(r"[A-Z][A-Z0-9-]+(?: (?:[A-Z][A-Z0-9-]*|-?\d[\d.]*))+")
ANOTHER_PLACE = re.compile(r"([A-Z-]+ .+ TO) another place first \(([A-Z0-9, -]+)\)")

ANOTHER_ARM = "another arm"

Feasible = Callable[[ParsedCommand], bool]
OtherArms = Callable[[], list[str]]  # that can do what is asked, in words


def without_infeasible(refusal: Refusal, feasible: Feasible, other_arms: OtherArms = list) -> Refusal:
    """The refusal with the alternatives of its advice that are feasible now. One for which the command waits is
    unchanged, and one of which only a strategy would remain that gives something up (VIA)."""
    if refusal.reason not in ABOUT or IN_THE_WAY in refusal.detail:
        return refusal
    test = _Test(feasible, other_arms)
    kept = [kept for step in refusal.clears.split(STEP) if (kept := test.step(step))]
    plain, left = (_without_strategy(words) for words in (refusal.clears, STEP.join(kept)))
    if not kept or (plain and not left and SENTENCE.search(STEP.join(kept))):
        return refusal
    kept[0] = kept[0].removeprefix("or ")
    return msgspec.structs.replace(refusal, clears=STEP.join(kept))


def _without_strategy(words: str) -> list[str]:
    return [one for one in SENTENCE.findall(words) if " VIA " not in one]


class _Test:
    def __init__(self, feasible: Feasible, other_arms: OtherArms) -> None:
        self._feasible, self._other_arms = feasible, other_arms
        self._known: dict[str, bool] = {}
        self._later = False  # a step before has a sentence, and changes what is feasible

    def step(self, words: str) -> str:
        """The step without the alternatives that are not feasible; empty if there is no other."""
        follows = not words.startswith("or ")
        if follows and self._later:
            return words
        options = words.split(OR)
        kept = [left for option in options if (left := self._option(option))]
        self._later = self._later or (follows and any(SENTENCE.search(one) for one in kept))
        prefix = "" if follows or not kept or kept[0].startswith("or ") else "or "
        return prefix + OR.join(kept)

    def _option(self, words: str) -> str:
        """The alternative, with a place that can be reached; empty if it is not feasible."""
        if elsewhere := ANOTHER_PLACE.search(words):
            places = [f"{elsewhere[1]} {name}" for name in elsewhere[2].split(", ")]
            place = next((one for one in places if self._is_feasible(one)), "")
            return words.replace(elsewhere[0], f"{place} first") if place else ""
        if ANOTHER_ARM in words:
            arms = " or ".join(self._other_arms())
            return words.replace(ANOTHER_ARM, f"{arms} instead") if arms else ""
        sentence = SENTENCE.search(words)
        return words if sentence is None or self._is_feasible(sentence[0]) else ""

    def _is_feasible(self, sentence: str) -> bool:
        if sentence not in self._known:
            parsed = parse(default_grammar(), sentence)
            is_task = isinstance(parsed, ParsedCommand) and parsed.kind == "task" and parsed.performer != OPERATOR
            full = len(self._known) >= TESTED
            self._known[sentence] = not is_task or full or self._feasible(parsed)  # type: ignore[arg-type]
        return self._known[sentence]
