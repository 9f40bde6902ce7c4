"""Tests of sentences on paper, one after the other: each is rehearsed in the world after those before it.

A sentence that is not feasible changes nothing, and neither does one that is itself a TEST.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import NamedTuple, Protocol

from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind

TEST = ("TEST", "SIMULATE")  # first words of a sentence that is a test already
ALL_FAULTS = "ASSUMING FAULTS"

OnEnd = Callable[[int, m.CommandEnded], None]


class AboutTest(NamedTuple):
    """The fields of a `CommandText` that refer to tests."""

    if_tested: str = ""
    after_test: str = ""
    label: str = ""


NO_TEST = AboutTest()


class Runs(Protocol):
    def run(self, text: str, *, after_test: str = "", label: str = "") -> m.CommandEnded: ...


class Asked(NamedTuple):
    """A TEST sentence to be run."""

    text: str
    after_test: str
    label: str


def rehearse(
    client: Runs,
    texts: Sequence[str],
    labels: Sequence[str] = (),
    *,
    faults: bool = False,
    keep_going: bool = False,
    on_end: OnEnd | None = None,
) -> list[m.CommandEnded]:
    """Test each sentence; the outcomes, up to the first that is not feasible unless `keep_going`.

    Each outcome has its `rehearsal`; the digest of the last feasible one names the whole list. `labels`: C-5 for each
    sentence, or empty; later sentences may name them. `faults`: walk through every stop reason of every step.
    """
    found: list[m.CommandEnded] = []
    asking = rehearsals(texts, labels, faults=faults, keep_going=keep_going)
    asked = next(asking, None)
    while asked is not None:
        ended = client.run(asked.text, after_test=asked.after_test, label=asked.label)
        if on_end is not None:
            on_end(len(found), ended)
        found.append(ended)
        asked = following(asking, ended)
    return found


def rehearsals(
    texts: Sequence[str], labels: Sequence[str] = (), *, faults: bool = False, keep_going: bool = False
) -> Generator[Asked, m.CommandEnded, None]:
    """The TEST sentences of `rehearse`, one after the other; each is sent the end of the one before it."""
    digest = ""
    for n, text in enumerate([texts] if isinstance(texts, str) else texts):  # a str is a sequence of letters, too
        asked = f"TEST {text.strip().removesuffix('.')}" + (f" {ALL_FAULTS}" if faults else "")
        ended = yield Asked(asked, digest, labels[n] if labels else "")
        if ended.outcome.kind is not OutcomeKind.SUCCEEDED:
            if not keep_going:
                return
        elif not is_test(text) and ended.outcome.rehearsal is not None:
            digest = ended.outcome.rehearsal.digest


def following(asking: Generator[Asked, m.CommandEnded, None], ended: m.CommandEnded) -> Asked | None:
    """The next TEST sentence after this end; None after the last."""
    try:
        return asking.send(ended)
    except StopIteration:
        return None


def is_test(text: str) -> bool:
    """Whether a sentence is a test already."""
    return text.split(maxsplit=1)[0].upper() in TEST if text.strip() else False


def digest_of(ended: Sequence[m.CommandEnded], texts: Sequence[str]) -> str:
    """The digest of the whole list: that of its last sentence that is feasible and no test; empty if there is none."""
    names = [
        one.outcome.rehearsal.digest
        for one, text in zip(ended, texts, strict=False)
        if one.outcome.rehearsal is not None and one.outcome.kind is OutcomeKind.SUCCEEDED and not is_test(text)
    ]
    return names[-1] if names else ""
