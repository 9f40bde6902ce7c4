"""The same advice is not given twice in a row: the same sentence would lead in a circle. Pure.

Kept is what sentences without success were advised, and which sentences of that advice were given since. What was tried
is left out of the same advice, and so is a sentence that would be tried first and has just ended without success
itself. The same words again name the command that got them. All this is forgotten when another sentence ends that may
have changed what the advice is about, and with the sentence's success.
"""

from __future__ import annotations

import re

import msgspec

from broker.decisions.state import Advised, Command, State
from rtc.protocol import causes
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason

KEPT = 64  # sentences
OF_VALUE = "SET"  # its figures stand in the advice as letters, or as those of before
PART = re.compile(r"(; |, or | or (?=[A-Z]{3}))")  # steps of an advice, and alternatives of a step
STEP, THEN = "; ", ", then "
AGAIN = re.compile(r"\b(?:again|repeat)\b")
#: the same sentence may be done later, although nothing is done for it
PASSING = (RefusalReason.RESOURCE, RefusalReason.OVERLOAD, RefusalReason.STALE, RefusalReason.TIMEOUT)


def judged(state: State, command: Command, kind: OutcomeKind, refusal: Refusal | None) -> Refusal | None:
    """The refusal of a task that ends, with advice that was not given to the same sentence just before."""
    if command.head is None or command.head.test or command.head.kind not in ("task", "data"):
        return refusal
    text = " ".join(command.text.upper().split())
    before = state.advised.pop(text, None)
    succeeded = kind is OutcomeKind.SUCCEEDED
    in_vain = _is_in_vain(text, kind, refusal)
    for sentence, one in list(state.advised.items()):
        if _names(one.clears, text):
            one.in_vain &= not succeeded
            one.tried += [text] if succeeded or in_vain else []
        elif kind is not OutcomeKind.REFUSED or command.primitives:  # else it has changed nothing
            del state.advised[sentence]
    if succeeded or refusal is None or not refusal.clears:
        return refusal
    same = before is not None and before.clears == refusal.clears
    tried = before.tried if before is not None and same else []
    elsewhere = [sentence for sentence, one in state.advised.items() if one.in_vain]
    if isinstance(refusal.cause, causes.AlreadyDone) and tried:  # what remained was done
        words = f"nothing is left to do; {tried[-1]} was the last of it"
    else:
        words = _without(refusal.clears, tried, elsewhere, command.id, again=same)
    state.advised[text] = Advised(command.id, refusal.clears, words, in_vain, tried)
    if len(state.advised) > KEPT:
        del state.advised[next(iter(state.advised))]
    if before is not None and words == before.words:
        words = f"as for {before.command}: {words}; rtc why {command.id} shows what was found"
    return msgspec.structs.replace(refusal, clears=words)


def _is_in_vain(text: str, kind: OutcomeKind, refusal: Refusal | None) -> bool:
    """Whether the same sentence would end so again, as long as nothing changes. Other figures may be accepted."""
    ended = kind in (OutcomeKind.FAILED, OutcomeKind.REFUSED) and text.split()[0] != OF_VALUE
    return ended and refusal is not None and refusal.reason not in PASSING and not _only_again(refusal.clears)


def _names(advice: str, text: str) -> bool:
    """Whether the advice contains this sentence; of SET its attribute, whatever its figures are."""
    sentence = " ".join(text.split()[:3]) if text.split()[0] == OF_VALUE else text
    after = "" if sentence is not text else r"(?! ?[A-Z0-9-])"
    return re.search(rf"(?<![A-Z0-9-]){re.escape(sentence)}{after}", advice) is not None


def _only_again(advice: str) -> bool:
    """Whether the advice has no sentence but the same one again."""
    parts = PART.split(advice)[::2]
    return all(AGAIN.search(part) or not re.search(r"\b[A-Z]{3,}\b", part) for part in parts) and bool(
        AGAIN.search(advice)
    )


def _without(clears: str, tried: list[str], elsewhere: list[str], command: str, *, again: bool) -> str:
    """The advice without what was tried after it, and without a first step that was tried `elsewhere`; if nothing else
    is left, where its causes are. `again`: the sentence was advised the same before."""
    parts = PART.split(clears)
    vain: list[str] = []
    kept: list[str] = []
    first = True
    for between, part in zip(["", *parts[1::2]], parts[::2], strict=True):
        first = first and between != STEP
        named = [one for one in tried if _names(part, one)]
        named += [one for one in elsewhere if first and _names(part.partition(THEN)[0], one)]
        vain += named
        if not named and not AGAIN.search(part):
            kept += [between if kept else "", part.removeprefix("or ") if not kept else part]
    if not vain and not (again and _only_again(clears)):
        return clears
    sentences = " and ".join(dict.fromkeys(vain)) or "the same sentence again"
    return "".join(kept) or f"{sentences} has not cleared it: rtc why {command} shows what was found"
