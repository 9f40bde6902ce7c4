"""A column, word or figure that a kind of step does not read is refused with its place, and all others are read."""

from __future__ import annotations

import ast
import re
from typing import get_args

import msgspec
import pytest
import yaml

from rtc.programs import checks, loader, step_kinds
from rtc.programs.compatibility import misfits
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, ScriptPiece
from rtc.protocol import wire
from rtc.protocol.messages import Step
from tests.source_files import ROOT

MOVE = "do: move, to: HERE, stop: move_free, space: move_task"
SEARCH = "do: move, to: HERE, stop: move_to_contact, space: move_task, expect: [contact]"
CIRCLE = "do: move, to: HERE, stop: move_held, space: move_circle"
GRIP = "do: grip, op: close"
LOOK = "do: look, who: camera, stop: look, expect: [found]"
HOLD = "do: hold, stop: hold"


BINDER = loader.decode(loader.default("binder"), BinderProgram)
ANALYZER = loader.decode(loader.default("analyzer"), AnalyzerProgram)


def problems(step: str) -> list[str]:
    """The places, with their problems, of a program with this step alone."""
    document = {"skill": "mine", "steps": [yaml.safe_load(f"{{{step}, label: x}}")]}
    piece = msgspec.convert(document, ScriptPiece)
    program = ElaboratorProgram(decision_tree=[], command_object_table=[], scripts=[], pieces=[piece])
    found = list(checks.CHECKS[ElaboratorProgram](program)) or list(misfits(program, BINDER, ANALYZER))
    return [f"{place}: {problem}" for place, problem in found]


@pytest.mark.parametrize(
    ("step", "place"),
    [
        # columns
        (f"{GRIP}, stop: move_free", "stop"),
        (f"{GRIP}, to: HERE", "to"),
        (f"{GRIP}, value: '1'", "value"),
        (f"{MOVE}, op: open", "op"),
        (f"{MOVE}, name: X", "name"),
        (f"{HOLD}, to: HERE, space: move_task, args: {{duration_s: 1}}", "to"),
        (f"{HOLD}, who: camera, args: {{duration_s: 1}}", "who"),
        # words
        (f"{MOVE}, words: {{place: HERE}}", "words.place"),
        (f"{MOVE}, words: {{seat: BAY-2}}", "words.seat"),
        (f"{MOVE}, words: {{operator_has: hand}}", "words.operator_has"),
        (f"{MOVE}, words: {{around: allowed}}", "words.around"),
        (f"{GRIP}, words: {{leaves: seat}}", "words.leaves"),
        (f"{GRIP}, words: {{about: HERE}}", "words.about"),
        (f"{LOOK}, words: {{until: ends}}", "words.until"),
        (f"{LOOK}, words: {{axis: TOOL-Z}}", "words.axis"),
        # effects of another kind of step, and figures without their effect
        (f"{GRIP}, words: {{effect: felt}}", "words.effect"),
        (f"{MOVE}, words: {{effect: sighted}}", "words.effect"),
        (f"{MOVE}, words: {{effect: taken}}", "words.effect"),
        (f"{MOVE}, words: {{missed: unseen}}", "words.missed"),
        (f"{SEARCH}, args: {{felt_m: 0.001}}", "args.felt_m"),
        (f"{SEARCH}, args: {{aside_m: 0.001}}, words: {{effect: felt}}", "args.aside_m"),
        (f"{MOVE}, args: {{beyond_m: 0.001}}", "args.beyond_m"),
        (f"{GRIP}, args: {{pad_m: 0.01}}", "args.pad_m"),
        (f"{LOOK}, args: {{seen_m: 0.01}}", "args.seen_m"),
        # figures of another kind of step
        (f"{MOVE}, args: {{width_m: 0.05}}", "args.width_m"),
        (f"{MOVE}, args: {{grip_n: 20}}", "args.grip_n"),
        (f"{MOVE}, args: {{by_turns: 1}}", "args.by_turns"),
        (f"{MOVE}, args: {{pictures: 3}}", "args.pictures"),
        (f"{MOVE}, args: {{duration_s: 3}}", "args.duration_s"),
        (f"{MOVE}, args: {{from_rad: 1}}", "args.from_rad"),
        (f"{GRIP}, args: {{takes_s: 1}}", "args.takes_s"),
        (f"{GRIP}, args: {{by_m: 0.1}}", "args.by_m"),
        (f"{HOLD}, args: {{duration_s: 1, width_m: 0.05}}", "args.width_m"),
        (f"{LOOK}, args: {{stiffness_n_m: 600}}", "args.stiffness_n_m"),
        (f"{LOOK}, args: {{within_m: 0.01}}", "args.within_m"),
        (f"{LOOK}, args: {{pictures: 2, duration_s: 3}}", "args.pictures"),
        ("do: hand_over, args: {force_n: 3}", "args.force_n"),
        # values of the binder's program that such a step does not read
        (f"{MOVE}, args: {{turn_rad: 1}}", "args.turn_rad"),
        (f"{MOVE}, args: {{spindle_rad_s: 1}}", "args.spindle_rad_s"),
        (f"{MOVE}, args: {{contact_nm: 1}}", "args.contact_nm"),
        (f"{GRIP}, args: {{settle_s: 1}}", "args.settle_s"),
        (f"{LOOK}, args: {{speed_m_s: 1}}", "args.speed_m_s"),
        # what a step lacks
        (f"{CIRCLE}, args: {{by_rad: 1}}", ""),
        (HOLD, ""),
        ("do: turn, stop: turn", ""),
        ("do: turn, stop: turn, args: {by_turns: 1, to_turns: 1}", ""),
        ("do: operate, stop: operated, words: {operator_has: spindle}", ""),
        ("do: operate, stop: operated, to: GP, space: move_joint", ""),
        ("do: juggle", "do"),
        # words without a meaning, and what a step without motion does not read
        (f"{MOVE}, words: {{leaves: slot}}", "words.leaves"),
        (f"{MOVE}, words: {{until: end}}", "words.until"),
        ("do: operate, stop: operated, words: {operator_has: feet}", "words.operator_has"),
        ("do: proc, name: grasp_plan, args: {width_m: 0.05}", "args"),
        ("do: let, name: A, value: '1', keep: {B: report.pose}", "keep"),
        ("do: let, name: A, value: '1', words: {effect: still_held}", "words.effect"),
    ],
)
def test_what_a_kind_of_step_does_not_read_is_refused_with_its_place(step: str, place: str) -> None:
    assert [one for one in problems(step) if one.startswith(f"pieces[0].steps[0]{place and '.' + place}: ")]


@pytest.mark.parametrize("step", [MOVE, f"{SEARCH}, args: {{beyond_m: 0.01, felt_m: 0.001}}, words: {{effect: felt}}"])
def test_what_it_reads_is_accepted(step: str) -> None:
    assert not [one for one in problems(step) if not re.match("(rules|search)", one)]


@pytest.mark.parametrize("kind", get_args(Step))
def test_each_kind_is_read_as_it_was_sent(kind: type[Step]) -> None:
    given = {float: 0.5, str: "name"}
    fields = {one.name: given[one.type] for one in msgspec.structs.fields(kind) if one.required}
    step = kind(**fields)
    assert wire.decoder(Step)(wire.encode(step)) == step
    assert type(wire.decoder(Step)(wire.encode(step))) is kind


def test_the_values_that_steps_read_are_those_of_the_code() -> None:
    """Names in `values[...]` of what makes primitives of steps, and those that a script may replace."""
    read = set[str]()
    rooms = ("conditions", "tasks", "binder", "mechanisms")
    for path in (path for room in rooms for path in (ROOT / "workers" / room).rglob("*.py")):
        if path.stem in ("assess", "predict", "advice", "elaborate") or path.parent.name == "facts":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Subscript):
                named = ast.unparse(node.value)
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
                named = ast.unparse(node.func.value)
            else:
                continue
            key = node.slice if isinstance(node, ast.Subscript) else node.args[0]
            if named.endswith("values"):
                read |= {str(one.value) for one in ast.walk(key) if isinstance(one, ast.Constant)}
    fields = {name for kind in get_args(Step) for name in step_kinds.figures_of(kind)}
    allowed = {name for names in step_kinds.VALUES.values() for name in names}
    computed = {"held_width_m", "time_limit_s"}
    assert sorted(allowed - read) == ["felt_nm"]  # the analyzer reads it
    assert sorted(read - allowed - fields - computed) == []
