"""Breakpoints that a command can reach, and those that would be accepted without effect."""

from __future__ import annotations

import pytest

from broker.router.breakpoints import ProgramBodies, refusal_of
from rtc.model.cells.cell import Cell
from rtc.programs.loader import default, merge
from rtc.protocol.messages import Breakpoint
from rtc.wording.advice import in_one_line

LONG = "scripts: [{script: linger, case: 1, uses: [hand], steps: [%s]}]\ndecision_tree: [{verb: STOW, script: linger}]"
STEP = "{do: hold, stop: hold, label: wait, args: {duration_s: 1.0}}"


def last_step(bodies: ProgramBodies, verb: str) -> int:
    """The highest step of a verb that is accepted."""
    return next(n for n in range(1000, 0, -1) if refusal_of([Breakpoint(verb, n)], bodies) is None)


@pytest.mark.parametrize("cell", ["servicing", "swapout"])
def test_a_step_that_no_command_reaches_is_refused(cell: str) -> None:
    """GRASP:99 of a program was accepted, and without effect. Looks that come first make a script longer."""
    bodies = ProgramBodies(default("parser"), default("elaborator"), Cell.load(cell).encode())
    alone = bodies._replace(cell=b"")
    assert last_step(alone, "STOW") < last_step(bodies, "STOW") < last_step(alone, "STOW") + 40
    beyond = last_step(bodies, "STOW") + 1
    refused = refusal_of([Breakpoint("STOW", 1), Breakpoint("STOW", beyond)], bodies)
    assert refused is not None
    assert f"step {beyond}" in refused.message  # wording: which of the two breakpoints
    assert f"1 to {last_step(alone, 'STOW')}" in in_one_line(refused.clears)


def test_the_longest_script_is_that_of_the_programs_in_use() -> None:
    before = ProgramBodies(default("parser"), default("elaborator"), b"")
    longer = merge("elaborator", before.elaborator, "s.yaml", (LONG % ", ".join(30 * [STEP])).encode())
    assert last_step(before, "STOW") < 30
    assert last_step(before._replace(elaborator=longer), "STOW") == 30


@pytest.mark.parametrize("verb", ["PAUSE", "FLY"])
def test_a_verb_without_a_script_has_no_step(verb: str) -> None:
    bodies = ProgramBodies(default("parser"), default("elaborator"), b"")
    assert refusal_of([Breakpoint(verb, 1)], bodies) is not None
