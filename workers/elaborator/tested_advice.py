"""The advice of a refusal, without the sentences that would be refused themselves. Pure.

Tested is what can be given now: the first sentence of each alternative. Left out is what has no way: what is out of
reach, say. A sentence that is refused for a state or a doubt comes after the sentence that its own refusal advises, if
that can be given. For another arm its sentence is stated, or nothing if none can do it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

from msgspec.structs import replace

from rtc.language.parse import default_grammar, parse
from rtc.protocol.advice import ANOTHER_ARM, Advice, Alternative, sentences_of
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import OPERATOR, ParsedCommand

TESTED = 6  # maximum number of sentences of an advice that are tested
TRIED = 8  # maximum number of sentences of each kind that are tested in the place of the refused one
ABOUT = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.SUSPECT)

Why = Callable[[ParsedCommand], Refusal | None]  # the refusal of a sentence in this world; None: it is accepted
OtherArms = Callable[[], Advice]  # that can do what is asked


def without_infeasible(refusal: Refusal, test: AdviceTest) -> Refusal:
    """The refusal with the alternatives of its advice that are feasible now. One for which the command waits is
    unchanged, and one of which only a strategy would remain that gives something up (VIA)."""
    if refusal.reason not in ABOUT or refusal.in_the_way:
        return refusal
    kept = test.feasible(refusal.clears)
    if not kept or (_gives_nothing_up(refusal.clears) and sentences_of(kept) and not _gives_nothing_up(kept)):
        return refusal
    return replace(refusal, clears=kept)


def _gives_nothing_up(advice: Advice) -> bool:
    tasks = [task for sentence in sentences_of(advice) if (task := _task(sentence)) is not None]
    return any(task.performer is None for task in tasks)


class AdviceTest:
    """Tests the sentences of one advice, and those in the place of the `asked` one, in the world of its refusal."""

    def __init__(self, why: Why, other_arms: OtherArms = list, asked: ParsedCommand | None = None) -> None:
        self._why, self._other_arms, self._asked = why, other_arms, asked
        self._known: dict[str, Refusal | None] = {}

    def feasible(self, advice: Advice) -> Advice:
        """The alternatives that can be given now; of those that differ in a place or a seat, the first one."""
        kept: Advice = []
        known: list[ParsedCommand] = []
        for one in advice:
            task = _task(one.sentences[0]) if one.sentences else None
            anywhere = None if task is None else replace(task, place=None, target=None)
            if anywhere is not None and anywhere in known:
                continue
            options = self._other_arms() if one == ANOTHER_ARM else self._option(one)
            kept += options
            known += [anywhere] if anywhere is not None and options else []
        return kept

    def leads_on(self, sentence: str) -> bool:
        """Whether it is a task of an arm or a camera that is accepted, and not the `asked` one."""
        task = _task(sentence)
        return task is not None and task != self._asked and task.performer is None and self._why(task) is None

    def first(self, sentences: Iterable[str]) -> str:
        """The first sentence of a few that leads on; empty if there is none."""
        some = itertools.islice(dict.fromkeys(sentences), TRIED)
        return next((one for one in some if self.leads_on(one)), "")

    def after_another(self, sentences: Iterable[str]) -> Advice:
        """The first sentence of a few that is accepted after another one, which its own refusal advises and which can
        be given now, with that one before it, in its place; empty if there is none."""
        for one in itertools.islice(dict.fromkeys(sentences), TRIED):
            if (before := self._clears(one)) is not None:
                return [replace(before, sentences=[*before.sentences, one], again=False, instead=True)]
        return []

    def _clears(self, sentence: str, *, twice: bool = True) -> Alternative | None:
        """What the refusal of this sentence advises first, if it can be given now, or asks a person for a pose; else
        None. `twice`: or after what its own refusal advises."""
        task = _task(sentence)
        refusal = self._why(task) if task is not None and task != self._asked else None
        if refusal is None or refusal.in_the_way or refusal.reason not in (RefusalReason.STATE, RefusalReason.SUSPECT):
            return None
        if (stated := _stated(refusal)) is not None:
            return stated
        before = next(iter(sentences_of(refusal.clears[:1])), "")
        if before in ("", sentence):
            return None
        if self.leads_on(before):
            return Alternative(sentences=[before])
        first = self._clears(before, twice=False) if twice else None
        return None if first is None else replace(first, sentences=[*first.sentences, before])

    def is_refused(self, one: Alternative) -> bool:
        """Whether this alternative has nothing but sentences of arms that have no way."""
        tasks = [_task(sentence) for sentence in one.sentences]
        return bool(tasks) and all(task is not None and self._is_infeasible(task) for task in tasks)

    def _is_infeasible(self, task: ParsedCommand) -> bool:
        refusal = self._why(task)
        return refusal is not None and refusal.reason is RefusalReason.INFEASIBLE

    def _option(self, one: Alternative) -> Advice:
        """The alternative, after the sentence that its first one needs; empty if that is not feasible."""
        first = next(iter(one.sentences), "")
        refusal = self._refusal(first) if first else None
        if refusal is None:
            return [one]
        if refusal.reason is RefusalReason.INFEASIBLE:
            return []
        if refusal.reason is RefusalReason.SUSPECT and (stated := _stated(refusal)) is not None:
            return [replace(one, sentences=[*stated.sentences, *one.sentences], states=[*stated.states, *one.states])]
        before = next(iter(sentences_of(refusal.clears)), "") if refusal.reason in ABOUT else ""
        if before == first:
            return []  # it is refused for what it should clear
        if not before or not self._is_accepted(before):
            return [one]
        return [replace(one, sentences=[before, *one.sentences])]

    def _is_accepted(self, sentence: str) -> bool:
        """Whether it is a task that can be given now."""
        return _task(sentence) is not None and len(self._known) < TESTED and self._refusal(sentence) is None

    def _refusal(self, sentence: str) -> Refusal | None:
        if sentence not in self._known:
            task = _task(sentence)
            full = len(self._known) >= TESTED
            self._known[sentence] = None if task is None or full else self._why(task)
        return self._known[sentence]


def _stated(refusal: Refusal) -> Alternative | None:
    """The first alternative of its advice, if that asks a person for the pose of a body; None if it is another one."""
    first = next(iter(refusal.clears), None)
    asks = first is not None and any(key.endswith(".frame") for key in first.states)
    return replace(first, again=False) if first is not None and asks else None


def _task(sentence: str) -> ParsedCommand | None:
    """The record of a task of an arm or a camera; None for other sentences."""
    parsed = parse(default_grammar(), sentence)
    is_task = isinstance(parsed, ParsedCommand) and parsed.kind == "task" and parsed.performer != OPERATOR
    return parsed if is_task else None  # type: ignore[return-value]
