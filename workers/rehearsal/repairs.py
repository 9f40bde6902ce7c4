"""Repairs of a sentence that is not feasible: sentences that were rehearsed in its place, and are feasible. Pure.

First sentences one name away: another hand or grasp point. Then the sentence after another one: those that the advice
of the refusal contains, and those that the elaborator's program lists. Last another seat or place, and another hand if
the sentence is about the hand itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

from rtc.language.hands import ARM_OF_WORD, OWN_WORDS, hand_in_words
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.advice import sentences_of
from rtc.protocol.causes import Collides, OutOfReach, TooUncertain, UnknownName
from rtc.protocol.messages import Fact
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.rehearsal import Repair
from rtc.protocol.sentence import ParsedCommand
from rtc.world.model import World
from workers.planning.scenes import CLEARANCE_M
from workers.planning.world_query import WorldQuery

TRIED = 12  # maximum number of lists of sentences that are rehearsed
OFFERED = 3  # maximum number of them that are offered
SAME = 1e-6  # m and rad: a difference below this is none
#: reasons of refusals that another sentence may avoid
REPAIRABLE = (RefusalReason.INFEASIBLE, RefusalReason.STATE, RefusalReason.SUSPECT, RefusalReason.NAME)
NAMES = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:[-_][A-Za-z0-9]+)*")

InVain = Callable[[World], bool]  # the world after the first sentence -> whether it cannot help the next one
#: sentences -> predicted duration of all (s); None: not feasible, or the first one is in vain
Rehearse = Callable[[list[str], InVain], float | None]


class Infeasible(NamedTuple):
    """A sentence that was refused: without TEST, and with the world before it."""

    text: str
    parsed: ParsedCommand
    refusal: Refusal
    query: WorldQuery


def tested(sentence: Infeasible, program: ElaboratorProgram, rehearse: Rehearse) -> list[Repair]:
    """The repairs whose rehearsal is feasible, the smallest changes first; none for refusals of other kinds."""
    if sentence.refusal.reason not in REPAIRABLE or sentence.parsed.kind != "task":
        return []
    found: list[Repair] = []
    options = {tuple(one): changes for one, changes in _options(sentence, program)}
    for sentences, changes in list(options.items())[:TRIED]:
        advised = sentences[0] in sentences_of(sentence.refusal.clears)  # the refusal knows more than its cause says
        predicted_s = rehearse([*sentences], _never if advised else partial(in_vain, sentence))
        if predicted_s is not None:
            found.append(Repair(sentences=[*sentences], changes=changes, predicted_s=predicted_s))
        if len(found) == OFFERED:
            break
    return found


def in_vain(sentence: Infeasible, after: World) -> bool:
    """Whether the sentence before it leaves the world as it was for the one that was refused. A pose that is known
    better counts only if the refusal is about a doubt, or about a distance that may be due to one."""
    refusal, before = sentence.refusal, sentence.query.world
    unsure = refusal.reason is RefusalReason.SUSPECT or isinstance(refusal.cause, TooUncertain)
    unsure |= isinstance(refusal.cause, Collides | OutOfReach) and refusal.cause.distance_m >= CLEARANCE_M
    changed = [fact for key, fact in after.facts.items() if before.facts.get(key) is not fact]
    return not any(_counts(sentence.query, fact, unsure=unsure) for fact in changed)


def _never(after: World) -> bool:
    return False


def _counts(query: WorldQuery, after: Fact, *, unsure: bool) -> bool:
    body, _, attribute = after.key.rpartition(".")
    before = query.world.facts.get(after.key)
    if attribute == "sighting":  # the pose is in other facts; here, that a camera finds again what it had missed
        return before is not None and before.value is None and after.value is not None
    if before is None:  # a frame may be that of the cell file
        return unsure or attribute != "frame" or not _same(query.pose(body).tolist(), after.value)
    if before.validity is not after.validity or not _same(before.value, after.value):
        return True
    return unsure and before.spread != after.spread


def _same(before: Any, after: Any) -> bool:
    numbers = isinstance(before, list) and isinstance(after, list) and len(before) == len(after)
    if numbers and all(isinstance(n, float | int) for n in (*before, *after)):
        return all(abs(a - b) < SAME for a, b in zip(before, after, strict=True))
    return bool(before == after)


Option = tuple[list[str], str]


def _options(sentence: Infeasible, program: ElaboratorProgram) -> Iterator[Option]:
    """First those that keep what the sentence is to achieve; another seat or place is last. Another hand does the same
    to an object; of a sentence about the hand itself it is another goal."""
    own = sentence.parsed.object is None
    if not own:
        yield from _one_name_away(sentence, _other_hands)
    yield from _one_name_away(sentence, _same_goal)
    yield from _one_sentence_before(sentence, program)
    if own:
        yield from _one_name_away(sentence, _other_hands)
    yield from _one_name_away(sentence, _elsewhere)


def _one_name_away(sentence: Infeasible, others: Callable[[Infeasible, str], Iterable[str]]) -> Iterator[Option]:
    for found in NAMES.finditer(sentence.text):
        word = found[0].upper().replace("_", "-")
        for other in others(sentence, word):
            text = f"{sentence.text[: found.start()]}{other}{sentence.text[found.end() :]}"
            yield [text], f"{other} instead of {word}"


def _other_hands(sentence: Infeasible, word: str) -> Iterable[str]:
    if word not in ARM_OF_WORD:
        return []
    arms = [arm.name for arm in sentence.query.cell.arms]
    same_form = [other for other, arm in ARM_OF_WORD.items() if arm in arms and (other == arm) == (word in arms)]
    further = [hand_in_words(arm) for arm in arms if arm not in OWN_WORDS]
    return [other for other in (*same_form, *further) if ARM_OF_WORD.get(other) != ARM_OF_WORD[word]]


def _same_goal(sentence: Infeasible, word: str) -> Iterable[str]:
    """Other grasp points in the place of this word, and known names in that of an unknown one."""
    cell, cause = sentence.query.cell, sentence.refusal.cause
    if isinstance(cause, UnknownName) and word == cause.name:
        return sentence.refusal.nearest or sentence.refusal.expected
    things = [thing for thing in cell.objects if thing.name == sentence.parsed.object]
    points = [point.name for thing in things for point in thing.grasp_points]
    return [name for name in points if name != word] if word in points else []


def _elsewhere(sentence: Infeasible, word: str) -> Iterable[str]:
    """Other seats or places in the place of this word."""
    for names in ([seat.name for seat in sentence.query.cell.seats], [place.name for place in sentence.query.places]):
        if word in names:
            return [name for name in names if name != word]
    return []


def _one_sentence_before(sentence: Infeasible, program: ElaboratorProgram) -> Iterator[Option]:
    advised = [one for one in sentences_of(sentence.refusal.clears) if one != sentence.refusal.by_operator]
    for before in (*advised, *_listed(sentence, program)):
        yield [before, sentence.text], f"{before} first"


def _listed(sentence: Infeasible, program: ElaboratorProgram) -> Iterator[str]:
    """The lines of the program, with the names of this sentence and of the cause of its refusal."""
    query, parsed = sentence.query, sentence.parsed
    own = [arm.name for arm in query.cell.arms if parsed.hand in (arm.name, None)]
    figures = sentence.refusal.figures().values()
    mentioned = {re.split("[ .]", str(one))[0] for one in figures}  # "DOOR-2 panel", "MACS-NEW.frame"
    bodies = [part.name for group in (query.cell.objects, query.cell.seats) for part in group]
    names = {
        "other": [hand_in_words(arm.name) for arm in query.cell.arms if arm.name != parsed.hand],
        "arm": [hand_in_words(arm) for arm in own],
        "held": [held for arm in own if (held := query.holding(arm))],
        "object": [parsed.object] if parsed.object else [],
        "named": [name for name in bodies if name in mentioned],
    }
    for line in program.repairs:
        role = next((role for role in names if f"{{{role}}}" in line), "")
        yield from (line.replace(f"{{{role}}}", name) for name in names.get(role, []))
