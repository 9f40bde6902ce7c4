"""Steps that name a piece: replaced by its steps when the program is compiled, and refused if that cannot be."""

from __future__ import annotations

import pytest

from rtc.programs import loader
from rtc.programs.outcome_table import outcomes
from rtc.protocol.outcomes import ProgramError

SWEEP = """
skill: wave
steps:
  - {do: move, to: HERE, stop: move_free, space: move_task, label: out, args: {by_m: 0.02}, words: {axis: TOOL-X}}
  - {do: piece, name: rest-a-little}
"""
REST = "skill: rest-a-little\nsteps: [{do: hold, stop: hold, label: rest, args: {duration_s: 0.1}}]"
SCRIPT = """
script: wave-twice
case: 3
uses: [hand]
steps:
  - {do: piece, name: wave}
  - {do: piece, name: rest-a-little, trim: [1, 1]}
decision_tree: [{verb: STOW, script: wave-twice}]
trimming_stack: [{n: 1, skill: look-where-it-stands, fits: [refused]}]
"""


def with_script(bench, text: str = SCRIPT) -> None:
    for part in (REST, SWEEP, text):
        bench.load("elaborator", part)
    bench.load("elaborator", "decision_tree: [{verb: STOW, script: stow, enabled: false}]")


def test_a_step_that_names_a_piece_has_the_steps_of_the_piece(bench):
    with_script(bench)
    script = bench.elaborate("STOW RIGHT-ARM")
    assert [(step.label, step.trims) for step in script.steps] == [("out", []), ("rest", []), ("rest", [1])]
    assert bench.do("STOW RIGHT-ARM").labels == ["out", "rest", "rest"]


def test_the_table_of_outcomes_has_the_steps_of_the_pieces(bench):
    with_script(bench)
    rows = outcomes(*(bench.programs[kind] for kind in ("elaborator", "binder", "analyzer")), "wave-twice")
    assert {row.step for row in rows} >= {"1 out", "2 rest", "3 rest"}


@pytest.mark.parametrize(
    "text",
    [
        SCRIPT.replace("name: wave}", "name: wafe}"),
        SCRIPT.replace("name: wave}", "name: wave, stop: hold}"),
        SCRIPT.replace("trim: [1, 1]", "trim: [1, 2]"),
        "skill: rest-a-little\nsteps: [{do: piece, name: wave}]",  # and wave names it
        "skill: self\nsteps: [{do: piece, name: self}]",
        "skill: nameless\nsteps: [{do: hold, stop: hold}]",
    ],
)
def test_a_piece_that_cannot_be_spliced_is_refused_when_it_is_loaded(bench, text):
    with pytest.raises(ProgramError):
        with_script(bench, text)


def test_a_step_of_a_piece_must_fit_the_plan_of_the_script(bench):
    bench.load("elaborator", REST.replace("do: hold", "do: move, to: NOWHERE, space: move_joint"))
    with pytest.raises(ProgramError, match="NOWHERE"):
        bench.load("elaborator", SCRIPT.replace("name: wave}", "name: rest-a-little}"))


def test_a_grammar_file_that_extends_replaces_what_it_added_before():
    text = b'// sweeps\n%extend work: WIPE hand amount maintain reflex -> command\nWIPE: "WIPE"\n'
    before = loader.default("parser")
    once = loader.merge("parser", before, "wipe.lark", text)
    assert once.startswith(before.rstrip())
    assert loader.merge("parser", once, "wipe.lark", text) == once
    assert b"WIPE" not in loader.merge("parser", once, "wipe.lark", text.replace(b"WIPE", b"SWEEP"))
    with pytest.raises(ProgramError):
        loader.merge("parser", once, "other.lark", text)  # the word is defined twice
