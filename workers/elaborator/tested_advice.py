"""The advice of a refusal, without the sentences that would be refused themselves. Pure.

Tested is what can be given now: the first sentence of each alternative. Left out is what has no way: what is out of
reach, say. A sentence that is refused for a state or a doubt comes after the sentences that its own refusal advises, if
they can be given. Each is tested in the world after those before it, as far as that is known: what can be grasped in a
rack may not be carried out of it. For another arm its sentence is stated, or nothing if none can do it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from rtc.language.parse import default_grammar, parse
from rtc.protocol.advice import ANOTHER_ARM, NOTHING, Advice, Alternative, joined, sentences_of
from rtc.protocol.causes import Collides, Distrusted, TooUncertain
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand
from workers.planning.scenes import CLEARANCE_M

TESTED = 6  # maximum number of sentences of an advice that are tested
TRIED = 8  # maximum number of sentences of each kind that are tested in the place of the refused one
ABOUT = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.SUSPECT)

BEFORE = 3  # maximum number of sentences before one that is not accepted yet


class Why(Protocol):
    """The refusal of a sentence in one world; None: it is accepted."""

    def __call__(self, parsed: ParsedCommand, /) -> Refusal | None: ...

    def after(self, parsed: ParsedCommand, /) -> Why | None:
        """The same in the world after this sentence, which is accepted; None: that is not known."""

    def stated(self, keys: Iterable[str], /) -> Why | None:
        """The same after a person has stated these facts as they are believed to be; None: that is not known."""


OtherArms = Callable[[], Advice]  # that can do what is asked


def without_infeasible(refusal: Refusal, test: AdviceTest) -> Refusal:
    """The refusal with the alternatives of its advice that are feasible now. One for which the command waits is
    unchanged, and one of which only a strategy would remain that gives something up (VIA)."""
    if refusal.reason not in ABOUT or refusal.in_the_way:
        return refusal
    kept = test.feasible(refusal.clears)
    if not kept or (_gives_nothing_up(refusal.clears) and sentences_of(kept) and not _gives_nothing_up(kept)):
        kept = refusal.clears
    by_operator = refusal.by_operator if refusal.by_operator in sentences_of(kept) else ""
    return replace(refusal, clears=test.leading(refusal, kept), by_operator=by_operator)


def _gives_nothing_up(advice: Advice) -> bool:
    tasks = [task for sentence in sentences_of(advice) if (task := _task(sentence)) is not None]
    return any(task.performer is None for task in tasks)


class AdviceTest:
    """Tests the sentences of one advice, and those in the place of the `asked` one, in the world of its refusal."""

    def __init__(self, why: Why, other_arms: OtherArms = list, asked: ParsedCommand | None = None) -> None:
        self._why, self._other_arms, self._asked = why, other_arms, asked
        self._known: dict[str, Refusal | None] = {}

    def feasible(self, advice: Advice) -> Advice:
        """The alternatives that can be given now; of those that differ in a place or a seat, the first one. After one
        that names a hand, the same without a hand says nothing more."""
        kept: Advice = []
        known: list[ParsedCommand] = []
        for one in advice:
            task = _task(one.sentences[0]) if one.sentences else None
            anywhere = None if task is None else replace(task, place=None, target=None)
            if anywhere is not None and (anywhere in known or anywhere in [replace(task, hand=None) for task in known]):
                continue
            options = self._other_arms() if one == ANOTHER_ARM else self._option(one)
            kept += options
            known += [anywhere] if anywhere is not None and options else []
        return kept

    def leading(self, refusal: Refusal, advice: Advice) -> Advice:
        """The alternatives without those after which the `asked` sentence is refused for the same: a doubt about a pose
        that a look or a statement leaves too large, or bodies that still meet. A motion of these is in its place."""
        kept: Advice = []
        for one in advice:
            remains = self._remains(one) if isinstance(refusal.cause, Collides | TooUncertain | Distrusted) else None
            if remains is None or not _is_the_same(refusal, remains):
                kept.append(one)
            elif not one.again and not one.states:
                kept.append(replace(one, instead=True))
        return kept

    def _remains(self, one: Alternative) -> Refusal | None:
        """The refusal of the `asked` sentence after an alternative; None: it is accepted then, or that is not known."""
        for_person = one.instead or not (one.sentences or one.states)
        now: Why | None = None if for_person or self._asked is None else self._why
        if now is not None and one.states:
            now = now.stated(one.states)
        for sentence in one.sentences:
            task = _task(sentence)
            if task is not None or not one.states:  # else it states what `states` names
                now = now.after(task) if now is not None and task is not None and now(task) is None else None
        return now(self._asked) if now is not None and self._asked is not None else None

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
            led = self._led(self._why, one, BEFORE)
            if led is not None and (led.before.sentences or led.before.states):
                return [replace(led.before, sentences=[*led.before.sentences, one], instead=True)]
        return []

    def _led(self, why: Why, sentence: str, most: int) -> _Led | None:
        """What comes before a sentence so that it is accepted: what its refusals advise first, one after the other, or
        the pose that they ask a person for. None: that is not known, or more than `most` sentences."""
        task = _task(sentence)
        if task is None or task == self._asked:
            return None
        now: Why | None = why
        before = NOTHING
        while now is not None and (refusal := now(task)) is not None:
            if refusal.in_the_way or refusal.reason not in (RefusalReason.STATE, RefusalReason.SUSPECT):
                return None
            if (stated := _stated(refusal)) is not None:
                if set(stated.states) <= set(before.states):
                    return None
                led = _Led(stated, now.stated(stated.states))
            else:
                first = next(iter(sentences_of(refusal.clears[:1])), "")
                needs = None if first in ("", sentence, *before.sentences) else self._led(now, first, most - 1)
                if needs is None:
                    return None
                led = needs.then(first)
            before, now = joined(before, led.before), led.now
            if len(before.sentences) > most:
                return None
        return _Led(before, now)

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
            return [self._with_what_the_rest_needs(one)]
        if refusal.reason is RefusalReason.INFEASIBLE:
            return []
        if refusal.reason is RefusalReason.SUSPECT and (stated := _stated(refusal)) is not None:
            return [replace(one, sentences=[*stated.sentences, *one.sentences], states=[*stated.states, *one.states])]
        before = next(iter(sentences_of(refusal.clears)), "") if refusal.reason in ABOUT else ""
        if before == first:
            return []  # it is refused for what it should clear
        if not before or not self._is_accepted(before):
            return [one]
        return [self._with_what_the_rest_needs(replace(one, sentences=[before, *one.sentences]))]

    def _with_what_the_rest_needs(self, one: Alternative) -> Alternative:
        """The alternative, whose first sentence is accepted, with what its later ones need before them in the worlds
        after those before."""
        parts: list[Alternative] = []
        now: Why | None = self._why
        for sentence in one.sentences:
            led = self._led(now, sentence, 1) if now is not None and _task(sentence) is not None else None
            parts.append(joined(NOTHING if led is None else led.before, Alternative(sentences=[sentence])))
            now = None if led is None else led.then(sentence).now
        return one if len(parts) < 2 else joined(*parts, replace(one, sentences=[]))

    def _is_accepted(self, sentence: str) -> bool:
        """Whether it is a task that can be given now."""
        return _task(sentence) is not None and len(self._known) < TESTED and self._refusal(sentence) is None

    def _refusal(self, sentence: str) -> Refusal | None:
        if sentence not in self._known:
            task = _task(sentence)
            full = len(self._known) >= TESTED
            self._known[sentence] = None if task is None or full else self._why(task)
        return self._known[sentence]


def _is_the_same(refusal: Refusal, remains: Refusal) -> bool:
    """Whether what remains is what was refused: a doubt that is too large, or the same bodies."""
    before, after = refusal.cause, remains.cause
    if isinstance(after, TooUncertain):
        return True
    if not isinstance(after, Collides):
        return False
    unsure = after.distance_m >= CLEARANCE_M
    return unsure if not isinstance(before, Collides) else unsure or {*before.owners} == {*after.owners}


class _Led(NamedTuple):
    """What comes before a sentence, and the world then; None: that is not known."""

    before: Alternative
    now: Why | None

    def then(self, sentence: str) -> _Led:
        """The same with this sentence, which is accepted now."""
        task = _task(sentence)
        now = None if self.now is None or task is None else self.now.after(task)
        return _Led(joined(self.before, Alternative(sentences=[sentence])), now)


def _stated(refusal: Refusal) -> Alternative | None:
    """The first alternative of its advice, if that asks a person for the pose of a body; None if it is another one."""
    first = next(iter(refusal.clears), None)
    asks = first is not None and any(key.endswith(".frame") for key in first.states)
    return replace(first, again=False) if first is not None and asks else None


def _task(sentence: str) -> ParsedCommand | None:
    """The record of a task; None for other sentences."""
    parsed = parse(default_grammar(), sentence)
    return parsed if isinstance(parsed, ParsedCommand) and parsed.kind == "task" else None
