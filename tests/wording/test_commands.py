"""The chain of causes, from the notes of a command."""

from __future__ import annotations

from typing import Any

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.messages import NoteKind
from rtc.protocol.outcomes import Compared, Figure, Outcome, OutcomeKind, StopReason
from rtc.wording.commands import address, chain, link, trace_lines
from rtc.wording.feedback import in_words, stages


def note(phase: m.Phase, **fields: Any) -> m.ProgressNote:
    return m.ProgressNote(seq=1, at_s=10.5, command="C-7", phase=phase, **fields)


def ended(reason: StopReason) -> dict[str, Any]:
    return {"kind": NoteKind.STEP_ENDED, "reason": reason}


GOAL, FORCED = ended(StopReason.GOAL), ended(StopReason.FORCE_LIMIT)
AS_EXPECTED: dict[str, Any] = {"kind": NoteKind.JUDGED, "reason": StopReason.GOAL}
FAILED: dict[str, Any] = {
    "kind": NoteKind.OUTCOME,
    "outcome": OutcomeKind.FAILED,
    "message": "a finger landed on the handle",
}


def failed_in_step_2() -> m.CommandRecord:
    """As the Decision Unit tells it: what ends a phase bears the phase and the step that follow."""
    one, two = "1 of 2: go before HANDLE-A", "2 of 2: feel one side"
    notes = [
        note(m.Phase.PARSING),
        note(m.Phase.ELABORATING, node="parser@0", took_s=0.001),
        note(
            m.Phase.ELABORATING,
            node="elaborator@1",
            took_s=0.002,
            kind=NoteKind.PLANNED,
            message="grasp-centering of 2 candidates",
        ),
        note(m.Phase.BINDING, node="elaborator@1", took_s=0.002, step=one),
        note(m.Phase.EXECUTING, node="binder@2", took_s=0.02, step=one),
        note(m.Phase.EXECUTING, node="MCM", step=one, kind=NoteKind.STARTED),
        note(m.Phase.ANALYZING, node="MCM", took_s=2.5, step=one, **GOAL),
        note(m.Phase.ANALYZING, node="analyzer@3", took_s=0.001, step=one, **AS_EXPECTED),
        note(m.Phase.BINDING, node="analyzer@3", took_s=0.001, step=two),
        note(m.Phase.EXECUTING, node="binder@2", took_s=0.01, step=two, kind=NoteKind.BOUND, message="0.8 s predicted"),
        note(m.Phase.ANALYZING, node="MCM", took_s=1.0, step=two, **FORCED),
        note(m.Phase.ENDED, node="analyzer@3", took_s=0.001, step=two, **FAILED),
    ]
    outcome = Outcome(kind=OutcomeKind.FAILED, message="a finger landed on the handle", stop=StopReason.FORCE_LIMIT)
    return m.CommandRecord(
        command="C-7",
        text="GRASP MACS-OLD",
        source="aip",
        request="r",
        accepted_at_s=10.0,
        phase=m.Phase.ENDED,
        notes=notes,
        outcome=outcome,
        ended_at_s=14.0,
    )


def test_a_failure_has_every_link_of_its_last_step_and_one_line_for_the_others() -> None:
    assert chain(failed_in_step_2()) == [
        "C-7 was given by the aip: GRASP MACS-OLD",
        "parsed in 1.00 ms",
        "planned in 2.00 ms: grasp-centering of 2 candidates",
        "script line 1 of 2: go before HANDLE-A: MCM ended: goal after 2.50 s",
        "script line 2 of 2: feel one side",
        "    bound in 10 ms: 0.8 s predicted",
        "    reported by MCM in 1.00 s: monitor: ended: force_limit",
        "    judged in 1.00 ms: evaluator: failed: a finger landed on the handle",
    ]


def test_the_start_of_a_motion_has_no_duration() -> None:
    assert link(note(m.Phase.EXECUTING, node="MCM", kind=NoteKind.STARTED)) == "started by MCM"


def test_a_held_command_says_for_whom_it_waits() -> None:
    record = m.CommandRecord(
        command="C-8",
        text="STOW RIGHT-ARM",
        source="operator",
        request="r",
        accepted_at_s=10.0,
        phase=m.Phase.HELD,
        notes=[note(m.Phase.HELD, kind=NoteKind.IN_USE, about="RIGHT-ARM", owner="C-7")],
    )
    assert chain(record)[-1] == "held: RIGHT-ARM is in use by C-7"


def test_a_worker_has_an_address_in_the_cube_and_a_subsystem_has_none() -> None:
    assert [address(node) for node in ("binder@2", "parser@4", "MCM", "")] == ["10", "100", "", ""]


def test_what_the_analyzer_found_in_a_report_is_in_the_line_of_its_step() -> None:
    step = "1 of 1: look for MACS-OLD with CAMERA-2"
    notes = [
        note(m.Phase.ANALYZING, node="S&P", took_s=0.4, step=step, **ended(StopReason.FOUND)),
        note(
            m.Phase.ANALYZING,
            node="analyzer@3",
            step=step,
            kind=NoteKind.JUDGED,
            message="look for MACS-OLD",
            found="20.0 mm off; tags 8, 9",
        ),
    ]
    record = msgspec.structs.replace(
        failed_in_step_2(), notes=notes, outcome=Outcome(kind=OutcomeKind.SUCCEEDED, steps_done=1)
    )
    assert chain(record)[-1] == f"script line {step}: S&P ended: found after 400 ms; 20.0 mm off; tags 8, 9"


def judged(**fields: Any) -> m.ProgressNote:
    found = Compared(
        "LIFT", "move_held", [Figure("duration_s", 1.8, 2.5, 0.2), Figure("off_goal_m", 0.0, 0.001, 0.0015)]
    )
    return note(m.Phase.BINDING, node="analyzer@3", compared=found, **fields)


def test_the_stages_of_the_feedback_loop_are_named() -> None:
    (monitor,) = stages(note(m.Phase.ANALYZING, node="MCM", **GOAL))
    assert monitor == ("monitor", "ended: goal")
    found = stages(judged(kind=NoteKind.TRIM, message="lift MACS-NEW", trim=2, pieces=["regrasp MACS-NEW"]))
    assert [stage for stage, _ in found] == ["predictor", "evaluator", "trimmer"]
    assert found[1:] == [("evaluator", "lift MACS-NEW"), ("trimmer", "trim 2, regrasp MACS-NEW")]
    assert stages(note(m.Phase.EXECUTING, node="binder@2")) == []  # of the forward loop


def test_each_stage_has_a_line_of_the_trace() -> None:
    lines = trace_lines(judged(kind=NoteKind.JUDGED, message="lift MACS-NEW"), 10.0)
    assert len(lines) == 2
    assert "predictor: duration 2.5 s (1.8 +- 0.2) DRIFTS, off goal 1 mm (0 +- 1.5)" in lines[0]
    assert lines[1].strip() == "evaluator: lift MACS-NEW"


def test_a_step_that_ended_otherwise_has_no_figures() -> None:
    assert in_words(Compared("LIFT", "move_held")) == "it ended otherwise than predicted"
