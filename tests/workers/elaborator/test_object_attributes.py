"""Attributes of objects that a loaded file declares: stated by SET, and used by scripts, tables and decision tree."""

from __future__ import annotations

import msgspec
import pytest

from rtc.programs import loader
from rtc.protocol.messages import Script, Validity
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason

DECLARED = "settable: {shell: {unit: m, of: [shell], example: 12 MM}, grip: {unit: '1', of: [grip], example: '0.4'}}\n"
ROW = "command_object_table: [{verb: GRASP, name: MACS-NEW, values: {grip_n: 1000*object.shell_m}}]\n"
STRATEGY = """
script: grasp-shell
case: 1
uses: [hand, object, grasp_point]
steps: [{do: hold, stop: hold, label: wait, args: {duration_s: 100*object.shell_m*object.grip}}]
decision_tree: [{verb: GRASP, script: grasp-shell, likelihood: 1.0, when: [{of: object.shell_m, at_least: 0.01}]}]
"""


def stated(bench, *sentences: str) -> None:
    for sentence in sentences:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)


def grasp(bench) -> Script | Refusal:
    return bench.elaborate("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")


def test_one_file_declares_an_attribute_and_a_script_that_uses_it(bench):
    bench.load("elaborator", STRATEGY + DECLARED)
    stated(bench, "SET MACS-NEW SHELL 12 MM", "SET MACS-NEW GRIP 0.4")
    script = grasp(bench)
    assert script.context.script == "grasp-shell"
    assert script.steps[0].duration_s == pytest.approx(100 * 0.012 * 0.4)


def test_an_object_without_the_attribute_is_grasped_by_the_other_strategies(bench):
    """The branch does not hold; a note states which sentence would change that."""
    bench.load("elaborator", STRATEGY + DECLARED)
    script = grasp(bench)
    assert script.context.script == "grasp-centering"
    assert any("grasp-shell" in note and "SET MACS-NEW SHELL" in note for note in script.notes)


def test_a_script_whose_attribute_is_not_stated_is_refused_with_what_states_it(bench):
    bench.load("elaborator", STRATEGY + DECLARED)
    bench.load("elaborator", "decision_tree: " + _only("grasp-shell"))
    refusal = grasp(bench)
    assert (refusal.reason, refusal.where) == (RefusalReason.STATE, "MACS-NEW.shell")
    stated(bench, refusal.clears[0].sentences[0])
    refusal = grasp(bench)  # now the second attribute, of the step
    assert refusal.where == "MACS-NEW.grip"
    stated(bench, refusal.clears[0].sentences[0])
    assert grasp(bench).context.script == "grasp-shell"


def test_a_suspect_attribute_is_not_used(bench):
    bench.load("elaborator", STRATEGY + DECLARED)
    stated(bench, "SET MACS-NEW SHELL 12 MM", "SET MACS-NEW GRIP 0.4")
    bench.set_fact("MACS-NEW.grip", 0.4, Validity.SUSPECT)
    bench.load("elaborator", "decision_tree: " + _only("grasp-shell"))
    refusal = grasp(bench)
    assert refusal.where == "MACS-NEW.grip"
    assert refusal.cause.validity == Validity.SUSPECT


def test_a_row_of_the_table_is_computed_from_an_attribute(bench):
    bench.load("elaborator", DECLARED + ROW)
    assert grasp(bench).where == "MACS-NEW.shell"
    stated(bench, "SET MACS-NEW SHELL 12 MM")
    assert [step.grip_n for step in grasp(bench).steps if step.op == "close"] == [pytest.approx(12.0)]


def test_a_declared_attribute_has_its_unit(bench):
    bench.load("elaborator", DECLARED)
    assert isinstance(bench.elaborate("SET MACS-NEW SHELL 12 KG"), Refusal)
    assert isinstance(bench.elaborate("SET MACS-NEW GRIP 4 MM"), Refusal)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("elaborator", STRATEGY),
        ("elaborator", ROW),
        ("elaborator", (STRATEGY + DECLARED).replace("duration_s: 100*object.shell_m", "duration_s: object.shell_mm")),
        ("elaborator", (STRATEGY + DECLARED).replace("of: object.shell_m", "of: object.frame_m")),
        ("elaborator", "settable: {shell: {unit: inch, of: [shell], example: 1 INCH}}"),
        ("binder", "values: {free_speed_m_s: object.shell_m}"),
        ("elaborator", STRATEGY.replace("shell_m", "shell.m") + DECLARED),
    ],
)
def test_an_attribute_that_is_not_declared_is_refused_when_the_file_is_loaded(bench, kind, text):
    with pytest.raises(ProgramError):
        bench.load(kind, text)


def _only(script: str) -> str:
    """Rows that switch all other scripts of GRASP off."""

    rows = msgspec.json.decode(loader.default("elaborator"))["decision_tree"]
    others = [row["script"] for row in rows if row["verb"] == "GRASP" and row["script"] != script]
    return "[" + ", ".join(f"{{verb: GRASP, script: {name}, enabled: false}}" for name in others) + "]"
