"""Faults on paper: each stop reason of each step, with its trims, before anything moves."""

from __future__ import annotations

import pytest

from rtc.programs import loader
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.rehearsal import FaultBranch
from tests.workers.rehearsal.on_paper import OnPaper
from workers.elaborator import elaborate

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


def faults(sentence: str, word: str, paper: OnPaper | None = None) -> dict[tuple[str, str], FaultBranch]:
    """(label of the step, reason) -> branch."""
    found = (paper or OnPaper()).test(f"{sentence} ASSUMING {word}")
    assert found.refusal is None, found.refusal
    return {(one.step.partition(": ")[2], one.reason): one for one in found.rehearsal.faults}


@pytest.fixture(scope="module")
def grasp() -> dict[tuple[str, str], FaultBranch]:
    return faults(GRASP, "FAULTS")


def test_a_touch_that_is_not_felt_is_recovered_by_the_first_trim(grasp):
    branch = grasp["feel one side of HANDLE-A (GP1)", "no_contact"]
    assert (branch.recovered, branch.trims) == (True, ["vision MACS-NEW"])


def test_a_force_beyond_the_limit_restarts_the_script(grasp):
    branch = grasp["feel one side of HANDLE-A (GP1)", "force_limit"]
    assert (branch.recovered, branch.trims) == (True, ["grasp MACS-NEW"])


def test_a_hand_that_closes_on_nothing_has_no_recovery_and_says_so(grasp):
    branch = grasp["close on HANDLE-A", "no_contact"]
    assert not branch.recovered
    assert branch.clears


def test_every_step_that_moves_or_looks_is_walked_and_expected_ends_are_no_faults(grasp):
    assert len({step for step, _ in grasp}) == 8
    assert ("feel one side of HANDLE-A (GP1)", "contact") not in grasp
    assert ("close on HANDLE-A", "goal") not in grasp


def test_a_fault_changes_nothing_for_the_next_sentence():
    plain, assumed = OnPaper(), OnPaper()
    plain.test(GRASP)
    assumed.test(f"{GRASP} ASSUMING FAULTS")
    assert plain.paper == assumed.paper


def test_one_fault_may_be_named():
    found = faults("MOVE RIGHT-ARM TO BAY-2-FRONT", "COLLISION")
    assert [reason for _, reason in found] == ["collision"]


@pytest.mark.parametrize(("word", "expects"), [("NONSENSE", "SLIP"), ("SLIP", "COLLISION")])
def test_a_fault_that_no_step_can_end_with_is_refused_with_those_that_can(word: str, expects: str):
    found = OnPaper().test(f"MOVE RIGHT-ARM TO BAY-2-FRONT ASSUMING {word}")
    assert found.refusal is not None
    assert found.refusal.reason is RefusalReason.NAME
    assert expects in found.refusal.expected
    assert found.rehearsal.repairs == []  # the sentence itself is feasible


def test_a_trim_of_the_sentence_is_walked_too():
    paper = OnPaper()
    paper.test(GRASP)
    lift = "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM UNLESS SLIP THEN STOP AND TRY REGRASP"
    branch = faults(lift, "SLIP", paper)["lift MACS-NEW straight UP", "slip"]
    assert (branch.recovered, branch.trims[0]) == (True, "TRY REGRASP")


def test_a_trim_whose_own_step_cannot_be_done_is_no_recovery():
    file = b"""
skill: vision
about: a correction that the arm cannot do
steps:
  - {do: move, to: HERE, stop: move_free, space: move_task, label: "far away", args: {by_m: 5.0}, words: {axis: X}}
"""
    paper = OnPaper()
    broken = loader.merge("elaborator", loader.default("elaborator"), "broken.yaml", file)
    paper.programs[WorkerKind.ELABORATOR] = elaborate.compile(broken)
    branch = faults(GRASP, "NO-CONTACT", paper)["feel one side of HANDLE-A (GP1)", "no_contact"]
    assert (branch.recovered, branch.trims) == (False, ["vision MACS-NEW"])
