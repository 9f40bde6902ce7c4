"""Tests of sentences on paper, one after the other: each is rehearsed in the world after those before it.

A sentence that is not feasible changes nothing, and neither does one that is itself a TEST.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    digest = ""
    for n, text in enumerate(texts):
        asked = f"TEST {text.strip().removesuffix('.')}" + (f" {ALL_FAULTS}" if faults else "")
        ended = client.run(asked, after_test=digest, label=labels[n] if labels else "")
        found.append(ended)
        if on_end is not None:
            on_end(n, ended)
        if ended.outcome.kind is not OutcomeKind.SUCCEEDED:
            if not keep_going:
                break
        elif not is_test(text) and ended.outcome.rehearsal is not None:
            digest = ended.outcome.rehearsal.digest
    return found


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
