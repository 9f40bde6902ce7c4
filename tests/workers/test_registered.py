"""What programs are checked against when they are loaded is what the workers have."""

from __future__ import annotations

import pytest

from rtc import registered
from rtc.messages import AnalyzerInput
from rtc.outcomes import StopReason
from workers import analyzer, axes, binder, effects, legs, needs, situation, starting_points, stopping


@pytest.mark.parametrize(
    ("told", "there"),
    [
        (registered.NEEDS, needs.NEEDS),
        (registered.STARTS, starting_points.ANCHORS),
        (registered.AXES, axes.AXES),
        (registered.SPACES, legs.SPACES),
        (registered.ACTIONS, binder.ACTIONS),
        (registered.PROCEDURES, binder.PROCEDURES),
        (registered.PREDICATES, stopping.MAKERS),
        (registered.EFFECTS, effects.EFFECTS),
        (registered.KEPT, analyzer.SOURCES),
    ],
)
def test_every_name_that_is_told_has_its_code(told, there):
    assert sorted(told) == sorted(there)


def test_what_a_sentence_can_say_is_a_figure():
    for suffix in situation.SUFFIX.values():
        assert {f"amount{suffix}", f"by{suffix}"} <= {*registered.FIGURES}


def test_every_placeholder_of_a_label_is_filled_in(bench):
    told = {"attribute", "value"}  # of SET alone
    label = " ".join(f"{{{name}}}" for name in registered.PLACEHOLDERS if name not in told)
    step = f"{{do: hold, stop: hold, label: '{label}', args: {{duration_s: 1}}}}"
    bench.load("elaborator", f"script: stow\ncase: 1\nuses: [hand]\nsteps: [{step}]")

    assert "{" not in bench.elaborate("STOW LEFT-ARM").steps[0].label


def test_every_placeholder_of_a_failure_is_filled_in(bench):
    words = " ".join(f"{{{name}}}" for name in registered.FAILURE_PLACEHOLDERS)
    script = bench.elaborate("STOW LEFT-ARM")
    bound = bench.bind(script, script.steps[0])
    report = bench.subsystem.perform(bound.primitive, bound)
    data = AnalyzerInput(evaluation=bound.evaluation, report=report)

    assert "{" not in analyzer._words(words, data, StopReason.TIMEOUT)
