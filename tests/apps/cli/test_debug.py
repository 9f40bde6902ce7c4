"""Breakpoints as typed: which places a script can have."""

from __future__ import annotations

import pytest
import typer

from rtc.apps.cli.debug import longest_scripts, most_before, reachable
from rtc.model.cells.cell import Cell
from rtc.programs.loader import default, merge
from rtc.protocol.messages import Breakpoint

LONG = "scripts: [{script: linger, case: 1, uses: [hand], steps: [%s]}]\ndecision_tree: [{verb: STOW, script: linger}]"
STEP = "{do: hold, stop: hold, label: wait, args: {duration_s: 1.0}}"


def test_the_longest_script_of_a_verb_is_that_of_the_programs_in_use() -> None:
    before = default("elaborator")
    after = merge("elaborator", before, "s.yaml", (LONG % ", ".join(30 * [STEP])).encode())
    assert longest_scripts(before)["STOW"] < 30
    assert longest_scripts(after) == {**longest_scripts(before), "STOW": 30}


@pytest.mark.parametrize("cell", ["servicing", "swapout"])
def test_a_breakpoint_that_no_command_reaches_is_refused(cell, capsys) -> None:
    """It was set, with a remark: accepted and without effect. Looks that come first make a script longer."""
    program, known = default("elaborator"), Cell.load(cell)
    last, before = longest_scripts(program)["STOW"], most_before(program, known)
    assert 0 < before < 40
    for step, remarks in ((1, 0), (last, 0), (last + 1, 1), (last + before, 1)):
        assert len(reachable([Breakpoint("STOW", step)], program, known)) == remarks
    with pytest.raises(typer.Exit):
        reachable([Breakpoint("STOW", 1), Breakpoint("STOW", last + before + 1)], program, known)
    assert str(last) in capsys.readouterr().err
