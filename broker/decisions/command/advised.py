"""Advice that was followed and has not helped is not given again: the same sentence would lead in a circle. Pure.

Kept is what sentences without success were advised, and which sentences of that advice succeeded after them. It is
forgotten when another sentence ends, which may have changed what the advice is about, and with the sentence's success.
"""

from __future__ import annotations

import re

import msgspec

from broker.decisions.state import Advised, Command, State
from rtc.protocol.outcomes import OutcomeKind, Refusal

KEPT = 64  # sentences
OF_VALUE = "SET"  # its figures stand in the advice as letters, or as those of before
PART = re.compile(r"(; |, or | or (?=[A-Z]{3}))")  # steps of an advice, and alternatives of a step
AGAIN = re.compile(r"\b(?:again|repeat)\b")


def judged(state: State, command: Command, kind: OutcomeKind, refusal: Refusal | None) -> Refusal | None:
    """The refusal of a task that ends, without advice that was followed in vain."""
    if command.head is None or command.head.test or command.head.kind not in ("task", "data"):
        return refusal
    text = " ".join(command.text.upper().split())
    before = state.advised.pop(text, None)
    for sentence, one in list(state.advised.items()):
        if not _names(one.clears, text):
            del state.advised[sentence]
        elif kind is OutcomeKind.SUCCEEDED:
            one.done.append(text)
    if kind is OutcomeKind.SUCCEEDED or refusal is None or not refusal.clears:
        return refusal
    done = before.done if before is not None and before.clears == refusal.clears else []
    state.advised[text] = Advised(clears=refusal.clears, done=done)
    if len(state.advised) > KEPT:
        del state.advised[next(iter(state.advised))]
    followed = before is not None and before.clears == refusal.clears and (done or _only_again(refusal.clears))
    return _without(refusal, done, command.id) if followed else refusal


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


def _without(refusal: Refusal, done: list[str], command: str) -> Refusal:
    """The refusal without what was done; if nothing else is left, with what the trace tells."""
    parts = PART.split(refusal.clears)
    kept: list[str] = []
    for between, part in zip(["", *parts[1::2]], parts[::2], strict=True):
        if AGAIN.search(part) or any(_names(part, one) for one in done):
            continue
        kept += [between if kept else "", part.removeprefix("or ") if not kept else part]
    tried = " and ".join(dict.fromkeys(done)) or "the same sentence again"
    words = "".join(kept) or f"{tried} has not cleared it: rtc trace {command} shows what each step has found"
    return msgspec.structs.replace(refusal, clears=words)
