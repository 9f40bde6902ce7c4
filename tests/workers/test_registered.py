"""What programs are checked against when they are loaded is what the workers have."""

from __future__ import annotations

import pytest

from rtc import registered
from workers import analyzer, axes, binder, effects, elaborator, legs, situation, starting_points, stopping


@pytest.mark.parametrize(
    ("told", "there"),
    [
        (registered.NEEDS, elaborator.NEEDS),
        (registered.STARTS, starting_points.STARTS),
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
