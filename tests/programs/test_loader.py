"""Programs: put together from files, checked with the place named, changed by LOAD; and the table of outcomes."""

from __future__ import annotations

import re

import pytest

from rtc.language import dictionary
from rtc.programs import expressions, loader
from rtc.programs.checks import valueless, verbs
from rtc.programs.loader import decode
from rtc.programs.outcome_table import outcomes
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram
from rtc.protocol.digest import digest
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import OF_OPERATOR, ProgramError, StopReason
from rtc.spatial import geometry

KINDS = [kind.value for kind in WorkerKind]
SCRIPTS = [s.script for s in decode(loader.default("elaborator"), ElaboratorProgram).scripts]


def defaults() -> tuple[bytes, bytes, bytes]:
    return loader.default("elaborator"), loader.default("binder"), loader.default("analyzer")


@pytest.mark.parametrize("kind", KINDS)
def test_a_program_is_named_by_what_it_says(kind):
    body = loader.default(kind)

    assert re.fullmatch(r"[0-9a-f]{16}", digest(body))
    assert digest(body + b" ") != digest(body)


@pytest.mark.parametrize("kind", ["elaborator", "binder", "analyzer"])
def test_a_program_put_into_itself_is_itself(kind):
    body = loader.default(kind)

    assert loader.merge(kind, body, "same", body) == body


def test_a_script_takes_the_place_of_one_of_its_name():
    text = b"script: stow\ncase: 1\nuses: [hand]\nsteps: [{do: hold, stop: hold, label: stay, args: {duration_s: 1}}]"

    merged = decode(loader.merge("elaborator", loader.default("elaborator"), "s.yaml", text), ElaboratorProgram)

    assert [s.script for s in merged.scripts] == SCRIPTS
    assert next(s for s in merged.scripts if s.script == "stow").steps[0].label == "stay"


STAY = "case: 1\nuses: [hand]\nsteps: [{do: hold, stop: hold, label: stay, args: {duration_s: 1}}]"


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("elaborator", f"script: stow\n{STAY}", ["scripts: stow is changed"]),
        (
            "elaborator",
            f"script: mine\n{STAY}\ndecision_tree: [{{verb: STOW, script: mine}}]",
            ["decision_tree: STOW mine is new", "scripts: mine is new"],
        ),
        (
            "elaborator",
            f"script: mine\n{STAY}",
            [
                "scripts: mine is new",
                "no verb selects mine; add to the file: decision_tree: [{verb: VERB, script: mine}]",
            ],
        ),
        (
            "elaborator",
            "command_object_table: [{verb: GRASP, name: HANDLE-Z, values: {approach_m: 0.2}}]",
            ["command_object_table: GRASP any HANDLE-Z is new"],
        ),
        ("binder", "values: {torque_nm: 3.0}", ["values: torque_nm is changed"]),
        ("binder", "values: {}", []),
    ],
)
def test_what_a_file_changes_is_reported_item_by_item(kind, text, message):
    before = loader.default(kind)

    assert loader.changes(kind, before, loader.merge(kind, before, "x.yaml", text.encode())) == message


def test_a_value_of_the_binder_is_changed_alone():
    before = decode(loader.default("binder"), BinderProgram)

    after = decode(
        loader.merge("binder", loader.default("binder"), "v.yaml", b"values: {torque_nm: 3.0}"), BinderProgram
    )

    assert after.values == {**before.values, "torque_nm": 3.0}
    assert after.stop_classes == before.stop_classes


@pytest.mark.parametrize(
    "text",
    [
        "script: s\ncase: 3\nsteps: [{do: tell, label: x}]\ntrail_stack: [{n: 1, skill: vision}]",
        "scripts: [{script: s, case: 3, steps: [{do: tell, label: x}], trail_stack: [{n: 1, skill: vision}]}]",
    ],
)
def test_the_trimming_stack_may_have_its_name_of_figure_4(text):
    of_paper, ours = (
        loader.merge("elaborator", loader.default("elaborator"), "t.yaml", text.replace("trail_stack", name).encode())
        for name in ("trail_stack", "trimming_stack")
    )
    assert of_paper == ours


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (
            "script: s\ncase: 9\nsteps: [{do: tell, label: x}]",
            r"\$\.scripts\[\d+\]\.case.*\(in s\)",
        ),
        (
            "script: s\ncase: 3\nsteps: [{do: tell, label: x, trim: [1, 2]}]",
            r"\$\.scripts\[\d+\]\.steps\[0\]\.trim",
        ),
        (
            "script: s\ncase: 3\nsteps: [{do: move, stop: move_free, space: move_task, label: x, to: Q}]",
            r"\$\.scripts\[\d+\]\.steps\[0\]\.to: there is no binding",
        ),
        (
            "script: s\ncase: 1\nsteps: [{do: tell, label: x, args: {a: '2 +'}}]",
            r"steps\[0\]\.args\.a: '2 \+' is no",
        ),
        (
            "script: s\ncase: 2\nsteps: [{do: tell, label: x}]\ntrimming_stack: [{n: 1, skill: grasp}]",
            r"scripts\[\d+\]\.trimming_stack: actions .* cannot be trimmed",
        ),
        (
            "scripts: [{script: s, case: 3, trail_stack: [], trimming_stack: []}]",
            r"trail_stack: they are the same list",
        ),
        (
            "skill: s\nsteps: [{do: tell, label: x}]\ntrail_stack: []",
            r"unknown field `trail_stack`",
        ),
        ("decision_tree: [{verb: V, script: nix}]", r"\$\.decision_tree\[\d+\]\.script: there is no script nix"),
        ("decision_tree: [{verb: V, script: stow, when: [{of: 'a**2', at_least: 1}]}]", r"when\[0\]\.of"),
        ("constraints: {SPEED: {m/s: velocity}}", r"\$\.constraints\.SPEED\.m/s: there is no limit velocity"),
        ("- 1", r"\$: a program document is a map"),
        ("a: [", r"t\.yaml, line 2: "),
        ("scrpts: []", r"scrpts"),
        ("scripts: {a: 1}", r"\$\.scripts: must be a list"),
    ],
)
def test_a_bad_document_names_the_place(text, place):
    with pytest.raises(ProgramError, match=place):
        loader.merge("elaborator", loader.default("elaborator"), "t.yaml", text.encode())


@pytest.mark.parametrize("how", ["reflex: back_off", "back_off_m: 0.02", "reflex: stop, back_off_m: 0.02"])
def test_a_distance_to_back_off_goes_with_that_reflex(how):
    text = f"holding: [{{reason: slip, when: grip-force-below, limit: 3, {how}}}]"

    with pytest.raises(ProgramError, match=r"holding\[\d+\]\.back_off_m"):
        loader.merge("binder", loader.default("binder"), "t.yaml", text.encode())


def test_f_must_be_complete():
    text = b"stop_classes: {endless: {stops: [{reason: goal, when: goal-reached}]}}"

    with pytest.raises(ProgramError, match=r"stop_classes\.endless\.stops: F is not complete without time-above"):
        loader.merge("binder", loader.default("binder"), "t.yaml", text)


def test_every_reason_needs_its_cell():
    with pytest.raises(ProgramError, match=r"\$\.outcomes\.odd: no cell for halt"):
        loader.merge("analyzer", loader.default("analyzer"), "t.yaml", b"outcomes: {odd: {goal: off_goal}}")


def test_a_grammar_that_does_not_compile_is_not_loaded():
    with pytest.raises(ProgramError, match=r"g\.lark"):
        loader.merge("parser", loader.default("parser"), "g.lark", b"sentence: (")


# --- outcomes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("script", SCRIPTS)
def test_no_cell_is_empty(script):
    """R67, R85: every (step, reason) has a response."""
    rows = outcomes(*defaults(), script)

    steps = dict.fromkeys(row.step for row in rows)
    assert steps
    assert all(row.response for row in rows)
    for step in steps:
        reasons = {row.reason for row in rows if row.step == step}
        assert reasons | OF_OPERATOR == set(StopReason) or reasons == {StopReason.GOAL}, step


def test_the_traced_outcomes_of_line_5():
    """requirements.md, 2.4."""
    message = {
        row.reason: row.response for row in outcomes(*defaults(), "grasp-centering") if row.step.startswith("5 ")
    }

    assert message[StopReason.CONTACT].startswith("continue")
    assert message[StopReason.GOAL] == "counts as no_contact"
    assert message[StopReason.NO_CONTACT].startswith("trim 1 (vision), retry_step or trim 2 (grasp), restart_script")
    assert message[StopReason.FORCE_LIMIT].startswith("trim 2 (grasp), restart_script")
    for reason in (StopReason.JOINT_LIMIT, StopReason.COLLISION, StopReason.TIMEOUT, StopReason.HALT):
        assert message[reason].startswith("fail"), reason


def test_a_verb_means_its_likeliest_script():
    assert outcomes(*defaults(), "GRASP") == outcomes(*defaults(), "grasp-feeling")


def test_an_unknown_script_is_reported():
    with pytest.raises(ProgramError, match="there is no script waltz"):
        outcomes(*defaults(), "waltz")


OTHERS = {kind: loader.default(kind) for kind in ("elaborator", "binder", "analyzer")}
SCRIPT = """# a skill of my own
script: s
case: 1
{more}
steps:
  - {{do: hold, stop: hold, label: stay, args: {{duration_s: 1}}}}
  - {step}
"""
GOOD = "{do: move, to: HERE, stop: move_free, space: move_task, label: x}"
CIRCLE = GOOD.replace("move_task, ", "move_circle, args: {by_rad: 1, by_m: 0}, words: {about: HERE}, ")
SPIRAL = GOOD.replace("move_task, ", "move_spiral, args: {radius_m: 0.01, pitch_m: 0.001}, ")
PLAN = "plan: [{name: A, at: destination, solve: true}]"


@pytest.mark.parametrize(
    ("step", "more", "message"),
    [
        (
            GOOD.replace("move_free", "move_fast"),
            "",
            r"line 7: .*steps\[1\].stop: there is no stop class move_fast; .*move_free",
        ),
        (GOOD.replace("move_task", "move_moon"), "", r"line 7: .*no space move_moon; there are move_both"),
        (
            GOOD.replace("do: move", "do: jump"),
            "",
            r"line 7: .*no action jump; there are answer, grip, hand_over, hold, .*move",
        ),
        (GOOD.replace(", stop: move_free", ""), "", r"line 7: .*needs stop"),
        ("{do: grip, op: twist, label: x}", "", r"line 7: .*no motion of the hand twist; there are close, open"),
        ("{do: proc, name: dance, label: x}", "", r"line 7: .*no procedure dance; there are grasp_init, grasp_plan"),
        (
            "{do: grip, op: open, label: x, words: {effect: gone}}",
            "",
            r"line 7: .*no effect gone; .*let_go",
        ),
        ("{do: grip, op: open, label: x, keep: {W: report.weight}}", "", r"line 7: .*no measured value report.weight"),
        ("{do: grip, op: open, label: x, args: {width_m: amout_m}}", "", r"line 7: .*no figure amout_m; .*amount_m"),
        (GOOD.replace("label", "words: {axis: SIDEWAYS}, label"), "", r"line 7: .*no axis SIDEWAYS; there are BACK"),
        (
            GOOD.replace("label", "words: {axis: WAY-OUT}, label"),
            "",
            r"line 7: .*WAY-OUT is for a move_task or a move_both from HERE",
        ),
        (
            GOOD.replace("label", "args: {by_m: 0.1, by_rad: 1}, words: {axis: WAY-OUT}, label"),
            "",
            r"line 7: .*by_rad has no effect along WAY-OUT",
        ),
        (GOOD.replace("label", "args: {pitch_m: 0.001}, label"), "", r"line 7: .*no figure of a step pitch_m"),
        (GOOD.replace("HERE", "A").replace("label", "args: {by_m: 0.1}, label"), PLAN, r"line 7: .*by_m is a step"),
        (GOOD.replace("label", "words: {about: HERE}, label"), "", r"line 7: .*no word that acts about"),
        (CIRCLE.replace("by_rad: 1, ", ""), "", r"line 7: .*move_circle needs by_rad"),
        (CIRCLE.replace("words: {about: HERE}, ", ""), "", r"line 7: .*move_circle needs about"),
        (CIRCLE.replace("to: HERE", "to: A"), PLAN, r"line 7: .*move_circle begins HERE, not at A"),
        (CIRCLE.replace("about: HERE", "about: A"), PLAN, r"line 7: .*no pose of the plan .*A"),
        (CIRCLE.replace("by_m: 0", "press_n: 3"), "", r"line 7: .*a move_circle has no axis to press along"),
        (SPIRAL.replace("pitch_m", "by_m"), "", r"line 7: .*move_spiral needs pitch_m"),
        (SPIRAL.replace("move_spiral", "move_raster").replace("radius_m", "by_m"), "", r"line 7: .*needs radius_m"),
        (SPIRAL.replace("label", "words: {about: HERE}, label"), "", r"line 7: .*no word that acts about"),
        (GOOD, "needs: [hand_clean]", r"line 4: .*no condition of the world hand_clean; there are driver_held"),
        (GOOD, "plan: [{name: A, at: moon}]", r"line 4: .*no anchor moon; there are bolt"),
        (GOOD, "plan: [{name: A, at: seat, along: SIDEWAYS}]", r"line 4: .*no axis SIDEWAYS; .*WAY-OUT"),
    ],
)
def test_a_script_that_asks_for_what_is_not_there_is_not_loaded(step, more, message):
    """The message has the known words and the line of the file."""
    text = SCRIPT.format(step=step, more=more).encode()

    with pytest.raises(ProgramError, match=rf"^s\.yaml, {message}"):
        loader.merge("elaborator", loader.default("elaborator"), "s.yaml", text, OTHERS)


def test_the_line_is_that_of_the_file_whatever_it_brings():
    text = b"decision_tree:\n- {verb: STOW, script: stow}\n- verb: LIFT\n  script: nix\n"

    with pytest.raises(
        ProgramError, match=r"^t\.yaml, line 4: \$\.decision_tree\[\d+\]\.script: there is no script nix"
    ):
        loader.merge("elaborator", loader.default("elaborator"), "t.yaml", text, OTHERS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            b"stop_classes:\n  mine:\n    stops: [{reason: goal, when: wished}]",
            "line 3: .*no predicate wished; there",
        ),
        (b"procedures: {grasp_init: pray}", "line 1: .*no procedure pray; there are grasp_plan, open_hand"),
        (
            b"stop_classes: {move_hinged: {stops: [{reason: goal, when: goal-reached},"
            b" {reason: timeout, when: time-above}]}}",
            "it is incompatible with the elaborator's program: .*no figure .*turn_rad",
        ),
    ],
)
def test_so_with_the_binder(text, message):
    with pytest.raises(ProgramError, match=message):
        loader.merge("binder", loader.default("binder"), "b.yaml", text, OTHERS)


def test_every_figure_is_si():
    """Names end in their unit, and none in one that is not SI. Turns of a thread are counted, as in a sentence."""
    document = decode(loader.default("elaborator"), ElaboratorProgram)
    names = {name for row in document.command_object_table for name in row.values}
    names |= set(decode(loader.default("binder"), BinderProgram).values)
    names |= set(decode(loader.default("analyzer"), AnalyzerProgram).values)

    assert names
    for name in names:
        assert re.search(r"_(m|rad|s|n|nm|kg|factor|share|m_s2|rad_s|turns)$", name), name


# --- expressions -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [("1 + 2*3", 7.0), ("-(a - 1)/2", -2.0), ("min(a, 3)", 3.0), ("abs(-a) + max(1, 2)", 7.0), (0.5, 0.5)],
)
def test_numbers(text, value):
    assert expressions.evaluate(text, {"a": 5.0}) == value


@pytest.mark.parametrize(
    "text",
    [
        "a.b",
        "a[0]",
        "__import__('os')",
        "lambda: 1",
        "a if a else 1",
        "'x'",
        "True",
        "a**9",
        "f(1)",
        "1/0",
        "b",
        "",
        "p",
    ],
)
def test_what_is_no_arithmetic_is_refused(text):
    with pytest.raises(expressions.ExpressionError):
        expressions.number(text, {"a": 5.0, "p": [0.0] * 6 + [1.0]})


def test_poses_are_averaged():
    one, other = [0.0, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0], [0.2, 0.1, 0.0, 0.0, 0.0, 0.0, -1.0]

    assert expressions.evaluate("0.5*(A + B)", {"A": one, "B": other}) == pytest.approx([0.1, 0.1, 0.1, 0, 0, 0, 1])
    assert expressions.evaluate("A/4 + 0.75*B", {"A": one, "B": other})[0] == pytest.approx(0.15)


@pytest.mark.parametrize("text", ["A + B", "A - B", "A*B", "2*A - B", "min(A, 1)", "A + 1"])
def test_other_sums_of_poses_mean_nothing(text):
    given = {"A": list(geometry.IDENTITY), "B": list(geometry.IDENTITY)}

    with pytest.raises(expressions.ExpressionError):
        expressions.evaluate(text, given)


LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}, *a{n - 1}]\n" for n in range(1, 40))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested deeper"),  # would overflow the C stack of the YAML loader
        ("- " * 60_000, "nested deeper"),
        (LAUGHS, "more than"),  # stands for 3^40 values
        ("values: &a {x: *a}", "the alias a has no anchor"),
        ('{"a":' * 50_000, "nested deeper"),
        ("scripts: [{script: [1]}]", "$.scripts[0].script"),
        ("scripts: 3", "$.scripts"),
        ("", "a program document is a map"),
    ],
)
def test_a_harmful_file_is_refused(text, message):
    with pytest.raises(ProgramError, match=re.escape(message)):
        loader.merge(WorkerKind.ELABORATOR, loader.default("elaborator"), "bad.yaml", text.encode())


def test_an_alias_may_be_used():
    text = b"values: {a: &a 1.0, b: *a}"
    body = loader.merge(WorkerKind.BINDER, loader.default("binder"), "good.yaml", text)
    assert decode(body, BinderProgram).values["b"] == 1.0


@pytest.mark.parametrize(
    ("kind", "text", "complaint"),
    [
        ("binder", b"# mine\nscript: my-lift\n", "line 2: .*script goes INTO elaborator; a binder .* has .*stop_"),
        ("binder", b"\nactoins: {}\n", "mine.yaml, line 2: .*no section actoins; it has clears, computes"),
        ("analyzer", b"", "mine.yaml: the file is empty; .*classes"),
        ("elaborator", b"scripts:\n  - [\n", "mine.yaml, line 3: "),
        ("elaborator", b"clears:\n  frame: look where it is\n", "mine.yaml, line [12]: .*array.*clears"),
        ("binder", b"clears:\n  frame: [{sentence: STOW A}]\n", "mine.yaml, line 2: .*unknown field `sentence`"),
    ],
)  # fmt: skip
def test_the_refusal_of_a_file_of_the_wrong_shape_names_what_is_expected(kind, text, complaint):
    with pytest.raises(ProgramError, match=complaint) as caught:
        loader.merge(kind, loader.default(kind), "mine.yaml", text)

    assert "byte string" not in str(caught.value)
    assert "NoneType" not in str(caught.value)


# --- what can never work ------------------------------------------------------------------------------------

HOLD = "do: hold, stop: hold, label: stay, args: {duration_s: 1}"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "decision_tree:\n- {verb: CARY, script: stow}",
            r"line 2: \$.decision_tree.*no verb of the language CARY",
        ),
        ("command_object_table:\n- {verb: CARY, values: {}}", "line 2: .*no verb of the language CARY"),
        (
            f"script: s\ncase: 1\nresources: [active_leg]\nsteps: [{{{HOLD}}}]",
            "line 3: .*no resource active_leg",
        ),
        (f"script: s\ncase: 1\nuses: [hnad]\nsteps: [{{{HOLD}}}]", "line 3: .*no field of a sentence hnad"),
        (
            "script: s\ncase: 1\nsteps:\n- {do: hold, stop: hold, label: x, args: {by_furlong: 3, duration_s: 1}}",
            "line 4: .*no figure of a step by_furlong; there are .*duration_s",
        ),
        (
            "script: s\ncase: 1\nsteps:\n- {do: hold, stop: hold, label: 'hold {objekt}', args: {duration_s: 1}}",
            "line 4: .*no placeholder objekt; there are .*object",
        ),
        (
            "script: s\ncase: 1\nsteps:\n- {do: hold, stop: hold, label: x, words: {efect: taken}}",
            "line 4: .*no word that acts efect",
        ),
        (
            "script: s\ncase: 1\nsteps:\n- {do: hold, stop: hold, label: x, args: {duration_s: 1/0}}",
            "line 4: .*'1/0' has no value: division by zero",
        ),
        (
            "script: s\ncase: 1\nsteps:\n- {do: hold, stop: hold, label: x, args: {duration_s: 1/(mass_kg - mass_kg)}}",
            "line 4: .*has no value: division by zero",
        ),
        (f"script: s\ncasee: 1\ncase: 1\nsteps: [{{{HOLD}}}]", "t.yaml, line 2: .*unknown field `casee`"),
        (
            f"script: s\ncase: 1\nstepz:\n- {{{HOLD}}}\nsteps: [{{{HOLD}}}]",
            "t.yaml, line 3: .*unknown field `stepz`.*; the keys are .*case, .*script, .*steps,",
        ),
        ("\0\1\2", "t.yaml: it is not a text file in UTF-8: "),
        (
            "decision_tree:\n- {verb: STOW, script: stow, when: [{gven: hand}]}",
            "line 2: .*unknown field `gven`",
        ),
    ],
)
def test_what_can_never_work_is_refused_when_it_is_loaded(text, complaint):
    programs = {kind: loader.default(kind) for kind in WorkerKind}

    with pytest.raises(ProgramError, match=complaint):
        loader.merge("elaborator", programs[WorkerKind.ELABORATOR], "t.yaml", text.encode(), programs)


def test_an_expression_that_may_have_a_value_is_none_that_never_has():
    assert valueless("1/(amount_m - by_m)") == ""
    assert valueless("0.5*(GP1 + GP2)") == ""


def test_the_verbs_of_a_grammar_are_those_that_sentences_begin_with():
    assert verbs(loader.default("parser").decode()) == {*dictionary.verbs()} - {"TEST"}


def test_an_unknown_placeholder_in_the_words_of_a_failure_is_refused():
    text = b"classes: {late: {message: 'not done within {limitt} s'}}"
    with pytest.raises(
        ProgramError, match=r"classes\.late\.message: there is no placeholder limitt; there are .*limit"
    ):
        loader.merge("analyzer", loader.default("analyzer"), "t.yaml", text)
