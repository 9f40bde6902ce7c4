"""What programs are checked against when they are loaded is what the workers have."""

from __future__ import annotations

import pytest

from rtc.language.quantities import AMOUNTS, STEP
from rtc.programs import extension_names, loader
from rtc.protocol.messages import AnalyzerInput
from rtc.protocol.outcomes import StopReason
from rtc.protocol.units import SUFFIXES
from workers.analyzer import analyze, world_changes
from workers.analyzer.analyze_task import AnalyzeTask
from workers.analyzer.failure_words import fill_in
from workers.binder import bind
from workers.conditions import stop_conditions
from workers.elaborator import anchors, preconditions
from workers.planning import axes, segments
from workers.planning.world_query import WorldQuery


@pytest.mark.parametrize(
    ("registered", "there"),
    [
        (extension_names.NEEDS, preconditions.NEEDS),
        (extension_names.ANCHORS, anchors.ANCHORS),
        (extension_names.AXES, axes.AXES),
        (extension_names.SPACES, segments.SPACES),
        (extension_names.ACTIONS, bind.ACTIONS),
        (extension_names.PROCEDURES, bind.PROCEDURES),
        (extension_names.PREDICATES, stop_conditions.MAKERS),
        (extension_names.EFFECTS, world_changes.EFFECTS),
        (extension_names.KEPT, analyze.SOURCES),
    ],
)
def test_every_registered_name_has_its_code(registered, there):
    assert sorted(registered) == sorted(there)


def test_what_a_sentence_can_say_is_a_figure():
    for unit in {unit for rule in (*AMOUNTS.values(), STEP) for unit in rule.units}:
        assert {f"amount_{SUFFIXES[unit]}", f"by_{SUFFIXES[unit]}"} <= {*extension_names.FIGURES}


def test_every_placeholder_of_a_label_is_filled_in(bench):
    registered = {"attribute", "value"}  # of SET alone
    label = " ".join(f"{{{name}}}" for name in extension_names.PLACEHOLDERS if name not in registered)
    step = f"{{do: hold, stop: hold, label: '{label}', args: {{duration_s: 1}}}}"
    bench.load("elaborator", f"script: stow\ncase: 1\nuses: [hand]\nsteps: [{step}]")

    assert "{" not in bench.elaborate("STOW LEFT-ARM").steps[0].label


def test_every_placeholder_of_a_failure_is_filled_in(bench):
    words = " ".join(f"{{{name}}}" for name in extension_names.FAILURE_PLACEHOLDERS)
    script = bench.elaborate("STOW LEFT-ARM")
    bound = bench.bind(script, script.steps[0])
    report = bench.subsystem.perform(bound.primitive, bound)
    data = AnalyzerInput(evaluation=bound.evaluation, report=report)
    task = AnalyzeTask(analyze.compile(loader.default("analyzer")), WorldQuery(bench.model, bench.world), data)

    assert "{" not in fill_in(words, task, StopReason.TIMEOUT)
