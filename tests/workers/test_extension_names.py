"""What programs are checked against when they are loaded is what the workers have."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

from rtc.language.quantities import AMOUNTS, STEP
from rtc.programs import extension_names, loader, step_kinds
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram
from rtc.protocol import advice as advice_texts
from rtc.protocol.messages import AnalyzerInput, InstalledStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.units import SUFFIXES
from tests.source_files import ROOT, source
from workers.analyzer import analyze
from workers.analyzer.failure_words import fill_in
from workers.binder import bind
from workers.conditions import stop_conditions
from workers.elaborator import anchors, script_checks
from workers.planning import axes, segments
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask

WORKERS = ROOT / "workers"


@pytest.mark.parametrize(
    ("registered", "there"),
    [
        (extension_names.NEEDS, script_checks.NEEDS),
        (extension_names.ANCHORS, anchors.ANCHORS),
        (extension_names.AXES, axes.AXES),
        (extension_names.SPACES, segments.SPACES),
        ({*step_kinds.KINDS.values()} - {InstalledStep}, bind.ACTIONS),
        (extension_names.PROCEDURES, bind.PROCEDURES),
        (extension_names.PREDICATES, stop_conditions.MAKERS),
        (step_kinds.EFFECTS, analyze.EFFECTS),
        (extension_names.KEPT_VALUES, analyze.SOURCES),
    ],
)
def test_every_registered_name_has_its_code(registered, there):
    assert sorted(map(str, registered)) == sorted(map(str, there))


def test_what_a_sentence_can_say_is_a_figure():
    for unit in {unit for rule in (*AMOUNTS.values(), STEP) for unit in rule.units}:
        assert {f"amount_{SUFFIXES[unit]}", f"by_{SUFFIXES[unit]}"} <= {*extension_names.FIGURES}


def test_every_placeholder_of_a_label_is_filled_in(bench):
    registered = {"attribute", "value"}  # of SET alone
    label = " ".join(f"{{{name}}}" for name in extension_names.PLACEHOLDERS if name not in registered)
    step = f"{{do: hold, stop: hold, label: '{label}', args: {{duration_s: 1}}}}"
    bench.load("elaborator", f"script: stow\ncase: 1\nuses: [hand]\nsteps: [{step}]")

    assert "{" not in bench.elaborate("STOW LEFT-ARM").steps[0].label


#: modules whose texts are given to all rows, or that compute the name of a row
OF_ALL_ROWS = (
    *("tasks/candidate.py", "elaborator/script_checks.py", "planning/trust.py"),
    *("mechanisms/collision_advice.py", "mechanisms/hinges/advice.py"),
)


@pytest.mark.parametrize(
    "program", [("elaborator", ElaboratorProgram), ("binder", BinderProgram), ("analyzer", AnalyzerProgram)]
)
def test_every_placeholder_of_advice_is_filled_in(program):
    """Each row of `clears` and `needs` is rendered with the names for which the modules that use it have texts."""
    kind, schema = program
    document = loader.decode(loader.default(kind), schema)
    for row, advice in {**document.clears, **getattr(document, "needs", {})}.items():
        users = [path for path in WORKERS.rglob("*.py") if row in source(path).texts]
        names = {name for path in (*users, *(WORKERS / one for one in OF_ALL_ROWS)) for name in keys_in(path)}
        rendered = advice_texts.fill_in(advice, dict.fromkeys(names, "NAME"))
        assert not re.findall(r"\{\w+\}", str(rendered)), row


@functools.cache
def keys_in(module: Path) -> set[str]:
    """The keys of the dictionaries in a module, and the names of keyword arguments."""
    nodes = [*ast.walk(ast.parse(module.read_text()))]
    keys = [key for node in nodes if isinstance(node, ast.Dict) for key in node.keys]
    keywords = {node.arg for node in nodes if isinstance(node, ast.keyword) and node.arg}
    return keywords | {key.value for key in keys if isinstance(key, ast.Constant)}


def test_every_placeholder_of_a_failure_is_filled_in(bench):
    words = " ".join(f"{{{name}}}" for name in extension_names.FAILURE_PLACEHOLDERS)
    script = bench.elaborate("STOW LEFT-ARM")
    bound = bench.bind(script, script.steps[0])
    report = bench.subsystem.perform(bound.primitive, bound)
    data = AnalyzerInput(evaluation=bound.evaluation, report=report)
    task = AnalyzeTask(analyze.compile(loader.default("analyzer")), WorldQuery(bench.model, bench.world), data)

    assert "{" not in fill_in(words, task, StopReason.TIMEOUT)
