"""The differences between predictions and reports, by verb and kind of step."""

from __future__ import annotations

from rtc.apps.cli.trust import as_row, by_kind
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Compared, Figure


def step(verb: str, kind: str, *measured_s: float, band_s: float = 0.2) -> m.ProgressNote:
    figures = [Figure("duration_s", 2.0, taken_s, band_s) for taken_s in measured_s]
    found = Compared(verb, kind, figures)
    return m.ProgressNote(seq=1, at_s=1.0, command="C-1", phase=m.Phase.BINDING, compared=found)


def record(*notes: m.ProgressNote) -> m.CommandRecord:
    return m.CommandRecord(
        command="C-1", text="X", source="operator", request="r", accepted_at_s=0.0, phase=m.Phase.ENDED, notes=[*notes]
    )


def test_steps_are_counted_by_verb_and_kind_over_all_commands() -> None:
    bare = m.ProgressNote(seq=1, at_s=1.0, command="C-1", phase=m.Phase.BINDING)
    kinds = by_kind(
        [
            record(step("STOW", "move_free", 2.0), bare),
            record(step("LIFT", "move_held", 2.0), step("STOW", "move_free", 2.1)),
        ]
    )
    assert {kind: len(steps) for kind, steps in kinds.items()} == {("LIFT", "move_held"): 1, ("STOW", "move_free"): 2}


def test_a_row_has_the_median_the_worst_and_the_number_outside_the_band() -> None:
    notes = [step("STOW", "move_free", taken_s) for taken_s in (2.0, 2.1, 1.5)]
    steps = by_kind([record(*notes)])["STOW", "move_free"]
    figure = as_row(("STOW", "move_free"), steps)["figures"]["duration_s"]
    assert figure == {"count": 3, "predicted": 2.0, "median": 0.0, "worst": -0.5, "outside": 1}


def test_a_step_that_ended_otherwise_is_unexpected_and_has_no_figure() -> None:
    steps = by_kind([record(step("STOW", "move_free"), step("STOW", "move_free", 2.0))])["STOW", "move_free"]
    row = as_row(("STOW", "move_free"), steps)
    assert (row["steps"], row["unexpected"], row["figures"]["duration_s"]["count"]) == (2, 1, 1)
