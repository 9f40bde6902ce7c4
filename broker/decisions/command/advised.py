"""The same advice is not given twice in a row: the same sentence would lead in a circle. Pure.

Kept is what sentences without success were advised, and which sentences of that advice were given since. What was tried
is left out of the same advice, and so is a sentence that would be tried first and has just ended without success
itself. The same words again name the command that got them. All this is forgotten when another sentence ends that may
have changed what the advice is about, and with the sentence's success.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from broker.decisions.state import Advised, Command, ParsedHead, State
from rtc.protocol import causes
from rtc.protocol.advice import Advice, Alternative, by_person
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason

MAX_ADVISED = 64  # sentences
OF_VALUE = "SET"  # a sentence that states a fact
#: the same sentence may be done later, although nothing is done for it
PASSING = (RefusalReason.RESOURCE, RefusalReason.OVERLOAD, RefusalReason.STALE, RefusalReason.TIMEOUT)


def judged(state: State, command: Command, kind: OutcomeKind, refusal: Refusal | None) -> Refusal | None:
    """The refusal of a task that ends, with advice that was not given to the same sentence just before."""
    head = command.head
    if head is None or head.test or head.kind not in ("task", "data"):
        return refusal
    text = " ".join(command.text.upper().split())
    before = state.advised.pop(text, None)
    succeeded = kind is OutcomeKind.SUCCEEDED
    in_vain = _is_in_vain(head, kind, refusal)
    done = _done(head, text)
    for sentence, one in list(state.advised.items()):
        if any(done in _todo(each) for each in one.clears):
            one.in_vain &= not succeeded
            one.tried += [done] if succeeded or in_vain else []
        elif kind is not OutcomeKind.REFUSED or command.primitives:  # else it has changed nothing
            del state.advised[sentence]
    if succeeded or refusal is None or not refusal.clears:
        return refusal
    same = before is not None and before.clears == refusal.clears
    tried = before.tried if before is not None and same else []
    elsewhere = [sentence for sentence, one in state.advised.items() if one.in_vain]
    if isinstance(refusal.cause, causes.AlreadyDone) and tried:  # what remained was done
        left = by_person(f"nothing is left to do; {tried[-1]} was the last of it")
    else:
        left = _without(refusal.clears, tried, elsewhere, command.id, again=same)
    state.advised[text] = Advised(command.id, refusal.clears, left, in_vain, tried)
    if len(state.advised) > MAX_ADVISED:
        del state.advised[next(iter(state.advised))]
    if before is not None and left == before.left:
        words = f"the advice is that for {before.command}: rtc why {command.id} shows what was found"
        left = [*left, *by_person(words)]
    return msgspec.structs.replace(refusal, clears=left)


def _is_in_vain(head: ParsedHead, kind: OutcomeKind, refusal: Refusal | None) -> bool:
    """Whether the same sentence would end so again, as long as nothing changes. Other figures may be accepted."""
    ended = kind in (OutcomeKind.FAILED, OutcomeKind.REFUSED) and head.verb != OF_VALUE
    return ended and refusal is not None and refusal.reason not in PASSING and not _only_again(refusal.clears)


def _done(head: ParsedHead, text: str) -> str:
    """The sentence; of one that states a fact its key, whatever its figures are."""
    return f"{head.object}.{head.attribute.lower()}" if head.verb == OF_VALUE and head.attribute else text


def _todo(one: Alternative) -> list[str]:
    """What an alternative asks for: facts that a person states, and sentences."""
    return [*one.sentences, *one.states]


def _only_again(advice: Advice) -> bool:
    """Whether the advice has no sentence but the same one again."""
    return not any(map(_todo, advice)) and any(one.again for one in advice)


def _without(advice: Advice, tried: list[str], elsewhere: list[str], command: str, *, again: bool) -> Advice:
    """The advice without what was tried after it, and without alternatives that begin with what was tried `elsewhere`;
    if nothing else is left, where its causes are. `again`: the sentence was advised the same before."""
    vain = [one for one in tried if any(one in _todo(each) for each in advice)]
    vain += [first for one in advice for first in one.sentences[:1] if first in elsewhere]
    if not vain and not (again and _only_again(advice)):
        return advice
    kept = [left for one in advice if (left := _left(one, tried, elsewhere)) is not None]
    sentences = " and ".join(dict.fromkeys(vain)) or "the same sentence again"
    return kept or by_person(f"{sentences} has not cleared it: rtc why {command} shows what was found")


def _left(one: Alternative, tried: Iterable[str], elsewhere: Iterable[str]) -> Alternative | None:
    """What is left of an alternative; None: nothing, or it begins with what was in vain."""
    if one.sentences[:1] and one.sentences[0] in elsewhere:
        return None
    todo = [each for each in _todo(one) if each not in tried]
    if not todo and (_todo(one) or one.again):
        return None
    sentences = [each for each in one.sentences if each in todo]
    return msgspec.structs.replace(one, sentences=sentences, states=[each for each in one.states if each in todo])
