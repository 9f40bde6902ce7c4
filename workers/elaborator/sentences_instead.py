"""Sentences that are accepted in the place of a refused one, if its advice has none that leads on. Pure.

First the same task in another form: with both arms, without what the sentence asks of the way, to another seat or
place, or by as much as there is room for. If none is accepted, a sentence that frees the arm, of those that the program
lists (`frees`). Each is tested on paper before it is advised.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import Advice, by_sentence, sentences_of
from rtc.protocol.causes import Collides, ExactArm, TooUncertain
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand, Quantity
from workers.elaborator.script_steps import Compiled
from workers.elaborator.tested_advice import AdviceTest
from workers.planning.world_query import WorldQuery
from workers.tasks.sentence_of import relative_amount, sentence_of

ABOUT = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.NO_SCRIPT, RefusalReason.SUSPECT)
ATTITUDE = "POSE-DURING-MOTION"  # MAINTAIN that protects nothing but what is carried
INTO_SEAT = "seat_free"  # precondition of a script that brings an object into a seat
SHARES = (0.9, 0.5)  # of the free part of a way
STEPS = {"m": 0.01, "rad": math.radians(1.0)}  # an advised amount is a multiple of this


def added(compiled: Compiled, refusal: Refusal, asked: ParsedCommand, query: WorldQuery, test: AdviceTest) -> Refusal:
    """The refusal, with a sentence in the place of the `asked` one if no task that it advises is accepted now. One for
    which the command waits is unchanged, and that of a doubt that a measurement clears."""
    clearable = refusal.reason is RefusalReason.SUSPECT and bool(refusal.clears)
    doubt = clearable and not isinstance(refusal.cause, TooUncertain)
    if asked.kind != "task" or doubt or refusal.reason not in ABOUT or refusal.in_the_way:
        return refusal
    ways = (*_by_less(asked, refusal), *_by_any_way(asked)) if isinstance(refusal.cause, Collides) else ()
    if less := _instead(test, ways):
        return replace(refusal, clears=[*less, *refusal.clears])
    if any(map(test.leads_on, sentences_of(refusal.clears))):
        return refusal
    kept = [one for one in refusal.clears if not test.is_refused(one)]
    # the measurement that clears a doubt clears the way for the asked one too
    if other := _instead(test, _other_forms(compiled, asked, query, refusal), later=not clearable):
        return replace(refusal, clears=[*other, *kept])
    if refusal.reason is RefusalReason.NO_SCRIPT or isinstance(refusal.cause, ExactArm):
        return refusal
    freeing = list(_freeing(compiled.program.frees, asked, query))
    if free := by_sentence(test.first(freeing), instead=True) or test.after_another(freeing):
        return replace(refusal, clears=[*kept, *free])
    return refusal


def _instead(test: AdviceTest, forms: Iterable[ParsedCommand], *, later: bool = True) -> Advice:
    """The first of these forms that is accepted now; `later`: or after another sentence."""
    sentences = list(filter(None, map(sentence_of, forms)))
    return by_sentence(test.first(sentences), instead=True) or (test.after_another(sentences) if later else [])


# --- the same task in another form -----------------------------------------------------------------------


def _other_forms(
    compiled: Compiled, asked: ParsedCommand, query: WorldQuery, refusal: Refusal
) -> Iterator[ParsedCommand]:
    arms = [arm.name for arm in query.cell.arms]
    if asked.hand in arms and query.sharers(asked.hand):
        yield replace(asked, hand=BOTH_ARMS)
    if asked.hand == BOTH_ARMS and asked.object is None and not any(map(query.sharers, arms)):
        yield from (replace(asked, hand=arm) for arm in arms)
    yield from _by_any_way(asked)
    yield from _by_less(asked, refusal)
    formless = refusal.reason is RefusalReason.NO_SCRIPT  # no place makes this form one that a script takes
    yield from _elsewhere(compiled, ([asked, *_by_any_way(asked)] if formless else [asked])[-1], query)


def _by_any_way(asked: ParsedCommand) -> Iterator[ParsedCommand]:
    """The sentence without what it asks of the way: its attitude, or its path."""
    free_way = [one for one in asked.constraints if one.slot != ATTITUDE]
    if free_way != asked.constraints:
        yield replace(asked, constraints=free_way)
    if asked.path is not None:
        yield replace(asked, path=None)
        yield replace(asked, path=None, constraints=free_way)


def _by_less(asked: ParsedCommand, refusal: Refusal) -> Iterator[ParsedCommand]:
    by = relative_amount(asked)
    if by is None or by.unit not in STEPS:
        return
    free = refusal.fraction
    for share in SHARES:
        steps = int(free * share * by.value / STEPS[by.unit])
        if steps:
            less = Quantity(value=round(steps * STEPS[by.unit], 9), unit=by.unit)
            place = asked.place
            yield replace(asked, amount=less) if place is None else replace(asked, place=replace(place, by=less))


def _elsewhere(compiled: Compiled, asked: ParsedCommand, query: WorldQuery) -> Iterator[ParsedCommand]:
    """The sentence with another seat that is free, or another place."""
    scripts = [compiled.scripts[row.script] for row in compiled.program.branches.get(asked.verb, [])]
    places, target, place = [place.name for place in query.places], asked.target, asked.place
    if target not in (None, *places) and any(INTO_SEAT in script.needs for script in scripts):
        taken = {query.seat(thing.name) for thing in query.cell.objects}
        free = [seat.name for seat in query.cell.seats if seat.name not in taken]
        yield from (replace(asked, target=name) for name in free if name != target)
    if target is not None and any({"place", "target"} <= set(script.uses) for script in scripts):
        yield from (replace(asked, target=name) for name in places if name != target)
    if place is not None and place.name is not None:
        yield from (replace(asked, place=replace(place, name=name)) for name in places if name != place.name)


# --- out of the way --------------------------------------------------------------------------------------


def _freeing(lines: list[str], asked: ParsedCommand, query: WorldQuery) -> Iterator[str]:
    """Sentences that free the arm of the sentence, or that which holds its object; else those that hold something."""
    arms = [arm.name for arm in query.cell.arms]
    holder = query.held_by(asked.object) if asked.object else ""
    own = next((name for name in (asked.hand, holder) if name in arms), "")
    for arm in [own] if own else filter(query.holding, arms):
        for line in lines:
            held = query.holding(arm)
            if "{held}" in line and not held:
                continue
            words = line.replace("{arm}", hand_in_words(arm)).replace("{held}", held)
            names = [place.name for place in query.places] if "{place}" in line else [""]
            yield from (words.replace("{place}", name) for name in names)
