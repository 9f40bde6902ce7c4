"""Trimmers that a program names: rules of an expert, and a search of a recovery that no script states."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.outcomes import StopReason

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
RESERVE = "reserve: [{skill: look-where-it-stands}, {skill: vision}, {skill: relocate, then: restart_script}]"
PREFERS_VISION = """
trimmers: [rules, stack]
rules:
  - {reasons: [force_limit], when: [{of: force_n, at_least: 20}], trim: grasp}
  - {classes: [touched_object], steps: [move_to_contact], trim: vision}
"""


def test_an_event_that_no_script_answers_is_recovered_by_a_searched_sequence(bench):
    """The approach of Figure 4 has no trims."""
    bench.subsystem.instead["C-1.3"] = StopReason.REFUSED
    assert not bench.do(GRASP).succeeded

    bench.load("elaborator", RESERVE)
    bench.load("analyzer", "trimmers: [stack, search]")
    bench.subsystem.instead["C-2.3"] = StopReason.REFUSED
    run = bench.do(GRASP)

    assert run.failure is None
    assert run.trims == [1001]
    assert bench.world.value("RIGHT-ARM.holding") == "MACS-NEW"


def test_a_recovery_of_several_pieces_is_performed_in_their_order(bench):
    bench.load("elaborator", "reserve: [{skill: look-where-it-stands}, {skill: vision}]")
    chain = """
trimmers: [search]
search: {most: 2, breaks: {timeout: [located, reported]}, pieces: {
  vision: {needs: [reported], makes: [located]}, look-where-it-stands: {makes: [reported]}}}
"""
    bench.load("analyzer", chain)
    bench.subsystem.instead["C-1.3"] = StopReason.TIMEOUT
    run = bench.do(GRASP)

    assert run.trims == [1001, 1002]
    labels = run.labels[3:6]
    assert [label.split()[0] for label in labels] == ["read", "look", "go"]  # then the failed step again
    assert run.failure is None


def test_a_recovery_is_tried_once_for_a_step(bench):
    bench.load("elaborator", RESERVE)
    bench.load("analyzer", "trimmers: [stack, search]")
    bench.subsystem.instead.update({f"C-1.{n}": StopReason.REFUSED for n in range(3, 9)})
    run = bench.do(GRASP)
    assert run.failure is not None
    assert run.failure.reason is StopReason.REFUSED


@pytest.mark.parametrize(("text", "expected"), [("trimmers: [stack]", 2), (PREFERS_VISION, 1001)])
def test_a_file_of_rules_changes_the_choice(bench, text, expected):
    bench.load("elaborator", "reserve: [{skill: vision}]")
    bench.load("analyzer", text.replace("touched_object", "overload_touching"))
    bench.subsystem.instead["C-1.5"] = StopReason.FORCE_LIMIT
    assert bench.do(GRASP).trims[0] == expected


@pytest.mark.parametrize(("force_n", "expected"), [(25.0, 2), (5.0, 1001)])
def test_a_rule_may_depend_on_what_was_measured(bench, force_n, expected):

    bench.load("elaborator", "reserve: [{skill: vision}]")
    bench.load("analyzer", PREFERS_VISION.replace("touched_object", "overload_touching"))
    script = bench.elaborate(GRASP)
    bench.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM")
    bound = bench.bind(script, script.steps[4])
    report = bench.subsystem.perform(bound.primitive, bound)
    report = msgspec.structs.replace(report, reason=StopReason.FORCE_LIMIT, peak_force_n=force_n)
    assert bench.analyze(bound, report).trim == expected


def test_without_a_reserve_a_script_is_as_before(bench):
    assert all(entry < 1000 for step in bench.elaborate(GRASP).steps for entry in step.trims)
