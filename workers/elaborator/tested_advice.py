"""The advice of a refusal, without the sentences that would be refused themselves. Pure.

An advice has steps, and a step has alternatives. Tested is what can be given now: the first sentence of a step, while
no step before it has one. Left out is what has no way: what is out of reach, say. A sentence that is refused for a
state or a doubt comes after the sentence that its own refusal advises, if that can be given. Another arm is named, or
left out if none can do it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable

import msgspec

from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import OPERATOR, ParsedCommand

TESTED = 6  # maximum number of sentences of an advice that are tested
TRIED = 8  # maximum number of sentences of each kind that are tested in the place of the refused one
ABOUT = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.SUSPECT)
SEQUEL = "then "  # begins a step that goes on from the one before
STEP, OR, THEN = "; ", ", or ", ", then "
SENTENCE = re.compile(r"[A-Z][A-Z0-9-]+(?: (?:[A-Z][A-Z0-9-]*(?:/[A-Z]+)?|-?\d[\d.]*))+")
ANOTHER_PLACE = re.compile(r"([A-Z-]+ .+ TO) another place first \(([A-Z0-9, -]+)\)")

ANOTHER_ARM = "another arm"

Why = Callable[[ParsedCommand], Refusal | None]  # the refusal of a sentence in this world; None: it is accepted
OtherArms = Callable[[], list[str]]  # that can do what is asked, in words


def without_infeasible(refusal: Refusal, test: AdviceTest) -> Refusal:
    """The refusal with the alternatives of its advice that are feasible now. One for which the command waits is
    unchanged, and one of which only a strategy would remain that gives something up (VIA)."""
    if refusal.reason not in ABOUT or refusal.in_the_way:
        return refusal
    kept = without_sequel([test.step(step) for step in refusal.clears.split(STEP)])
    plain, left = (_without_strategy(words) for words in (refusal.clears, STEP.join(kept)))
    if not kept or (plain and not left and SENTENCE.search(STEP.join(kept))):
        return refusal
    kept[0] = kept[0].removeprefix("or ")
    return msgspec.structs.replace(refusal, clears=STEP.join(kept))


def without_sequel(steps: list[str]) -> list[str]:
    """The steps that are left, without those that go on from one that is not."""
    kept: list[str] = []
    for before, step in itertools.pairwise(["-", *steps]):
        if step and (before or not step.startswith(SEQUEL)):
            kept.append(step)
    return kept


def _without_strategy(words: str) -> list[str]:
    return [one for one in SENTENCE.findall(words) if " VIA " not in one]


class AdviceTest:
    """Tests the sentences of one advice, and those in the place of the `asked` one, in the world of its refusal."""

    def __init__(self, why: Why, other_arms: OtherArms = list, asked: ParsedCommand | None = None) -> None:
        self._why, self._other_arms, self._asked = why, other_arms, asked
        self._known: dict[str, Refusal | None] = {}
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

    def leads_on(self, sentence: str) -> bool:
        """Whether it is a task of an arm or a camera that is accepted, and not the `asked` one."""
        task = _task(sentence)
        return task is not None and task != self._asked and task.performer is None and self._why(task) is None

    def first(self, sentences: Iterable[str]) -> str:
        """The first sentence of a few that leads on; empty if there is none."""
        some = itertools.islice(dict.fromkeys(sentences), TRIED)
        return next((one for one in some if self.leads_on(one)), "")

    def is_refused(self, words: str) -> bool:
        """Whether this step of an advice has nothing but sentences of arms that have no way."""
        sentences = [one for one in SENTENCE.findall(words) if isinstance(parse(default_grammar(), one), ParsedCommand)]
        own = [task for one in sentences if (task := _task(one)) is not None]
        return bool(own) and len(own) == len(sentences) and all(map(self._is_infeasible, own))

    def _is_infeasible(self, task: ParsedCommand) -> bool:
        refusal = self._why(task)
        return refusal is not None and refusal.reason is RefusalReason.INFEASIBLE

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
        refusal = self._refusal(sentence[0]) if sentence is not None else None
        if refusal is None or sentence is None:
            return words
        if refusal.reason is RefusalReason.INFEASIBLE:
            return ""
        before = SENTENCE.search(refusal.clears) if refusal.reason in ABOUT else None
        if before is not None and before[0] == sentence[0]:
            return ""  # it is refused for what it should clear
        if before is None or not self._is_accepted(before[0]):
            return words
        return f"{words[: sentence.start()]}{before[0]}{THEN}{words[sentence.start() :]}"

    def _is_feasible(self, sentence: str) -> bool:
        refusal = self._refusal(sentence)
        return refusal is None or refusal.reason is not RefusalReason.INFEASIBLE

    def _is_accepted(self, sentence: str) -> bool:
        """Whether it is a task that can be given now."""
        return _task(sentence) is not None and len(self._known) < TESTED and self._refusal(sentence) is None

    def _refusal(self, sentence: str) -> Refusal | None:
        if sentence not in self._known:
            task = _task(sentence)
            full = len(self._known) >= TESTED
            self._known[sentence] = None if task is None or full else self._why(task)
        return self._known[sentence]


def _task(sentence: str) -> ParsedCommand | None:
    """The record of a task of an arm or a camera; None for other words."""
    parsed = parse(default_grammar(), sentence)
    is_task = isinstance(parsed, ParsedCommand) and parsed.kind == "task" and parsed.performer != OPERATOR
    return parsed if is_task else None  # type: ignore[return-value]
