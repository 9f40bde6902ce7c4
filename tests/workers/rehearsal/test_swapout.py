"""All lines of the swap-out on paper, one after the other."""

from __future__ import annotations

import pytest

from examples.swapout import swapout
from rtc.apps.cli import sentence_files
from rtc.protocol.messages import Paper, RehearsalInput
from tests.workers.conftest import record
from tests.workers.rehearsal.on_paper import PROGRAMS, SERVICING, OnPaper
from workers.rehearsal import rehearse

#: they ask about later states (decision 0108)
REFUSED = {"C-1", "C-2"}


@pytest.mark.parametrize("first", [1, 50])
def test_every_line_is_feasible_but_the_tests(first):
    """`first`: number of the first command; the search for a way round depends on it."""
    world, before = OnPaper(SERVICING).world, None
    refused = {}
    for n, line in enumerate(sentence_files.read(swapout.LINES), first):
        before, why = _tested(world, f"TEST {line.text.removeprefix('TEST ')}", line.label, n, before)
        if why:
            refused[line.label] = why
    assert refused.keys() == REFUSED, refused


def _tested(world, text: str, label: str, number: int, before: Paper | None) -> tuple[Paper | None, str]:
    """What a line leaves, and why it is refused; empty if it is not."""
    data = RehearsalInput(
        command=f"C-{number}",
        text=text,
        parsed=record(text),
        label=label,
        at_s=100.0,
        moving=[],
        live=[],
        before=before,
    )
    found = rehearse.run(PROGRAMS, SERVICING, world, data)
    return (before, found.refusal.message) if found.refusal is not None else (found.after, "")
