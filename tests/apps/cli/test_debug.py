"""Breakpoints as typed: which places a script can have."""

from __future__ import annotations

from rtc.apps.cli.debug import longest_scripts
from rtc.programs.loader import default, merge

LONG = "scripts: [{script: linger, case: 1, uses: [hand], steps: [%s]}]\ndecision_tree: [{verb: STOW, script: linger}]"
STEP = "{do: hold, stop: hold, label: wait, args: {duration_s: 1.0}}"


def test_the_longest_script_of_a_verb_is_that_of_the_programs_in_use() -> None:
    before = default("elaborator")
    after = merge("elaborator", before, "s.yaml", (LONG % ", ".join(30 * [STEP])).encode())
    assert longest_scripts(before)["STOW"] < 30
    assert longest_scripts(after) == {**longest_scripts(before), "STOW": 30}
