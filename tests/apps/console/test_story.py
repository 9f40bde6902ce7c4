"""Commands as rows: spans of steps, trims, outcomes; numbered changes, and everything anew after a long gap."""

from __future__ import annotations

import msgspec

from rtc.apps.console.story import MAX_CHANGES, MAX_ROWS, Story
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason, StopReason


def story() -> Story:
    return Story(["A-ARM", "B-ARM"], {"A-HAND": "A-ARM"})


def note(seq: int, at_s: float, phase: m.Phase, step: str = "", **fields) -> m.ProgressNote:
    return m.ProgressNote(seq=seq, at_s=at_s, command="C-1", phase=phase, step=step, **fields)


def ended(seq: int, at_s: float, command: str = "C-1") -> m.CommandEnded:
    outcome = Outcome(kind=OutcomeKind.SUCCEEDED)
    return m.CommandEnded(
        seq=seq, at_s=at_s, command=command, request="r", text="STOW A-ARM", outcome=outcome, took_s=1
    )


STEP = [
    note(1, 10.0, m.Phase.PARSING),
    note(2, 10.1, m.Phase.EXECUTING, "1 of 1: go", node="binder@2", expected_s=2.5),
    note(3, 10.2, m.Phase.EXECUTING, "1 of 1: go", node="MCM", kind=m.NoteKind.STARTED),
    note(
        4,
        12.6,
        m.Phase.ANALYZING,
        "1 of 1: go",
        node="MCM",
        kind=m.NoteKind.STEP_ENDED,
        reason=StopReason.GOAL,
        took_s=2.4,
    ),
]


def test_a_step_is_a_span_from_its_start_to_its_report():
    made = story()
    for one in STEP:
        made.take(one)
    (span,) = made.rows["C-1"].spans
    assert (span.from_s, span.to_s, span.reason, span.expected_s) == (10.2, 12.6, "goal", 2.5)
    assert [phase for phase, _ in made.rows["C-1"].phases] == ["parsing", "executing", "analyzing"]


def test_a_record_replaces_what_is_known_and_its_notes_are_not_counted_twice():
    record = m.CommandRecord(
        command="C-1", text="MOVE A-HAND HOME", source="operator", request="r", accepted_at_s=9.9,
        phase=m.Phase.ANALYZING, notes=STEP,
    )  # fmt: skip
    made = story()
    made.take(STEP[0])
    made.take_record(record)
    for one in STEP:
        made.take(one)
    row = made.rows["C-1"]
    assert (len(row.spans), row.text, row.performers) == (1, "MOVE A-HAND HOME", ["A-ARM"])


def test_a_halt_in_a_step_ends_its_span():
    made = story()
    for one in STEP[:3]:
        made.take(one)
    made.take(ended(5, 11.0))
    assert made.rows["C-1"].spans[0].to_s == 11.0
    assert made.live == []


def test_trims_and_warnings_are_marks():
    made = story()
    made.take(note(1, 1.0, m.Phase.ANALYZING, kind=m.NoteKind.TRIM, message="off", trim=1, pieces=["again"]))
    made.take(note(2, 2.0, m.Phase.EXECUTING, kind=m.NoteKind.JUDGED, drift="drifts", warning=True))
    assert [(mark.kind, mark.at_s) for mark in made.rows["C-1"].marks] == [("trim", 1.0), ("warning", 2.0)]


def test_an_arm_that_executes_a_command_is_its_performer():
    made = story()
    made.take(STEP[0])
    made.take_performing([("B-ARM", "C-1"), ("A-ARM", "")])
    assert made.rows["C-1"].performers == ["B-ARM"]


def test_changes_are_numbered_and_given_again_after_a_gap():
    made = story()
    changes = []
    for one in STEP:
        made.take(one)
        changes.append(made.flush())
    assert made.flush() is None
    assert [msgspec.json.decode(one)["change"]["n"] for one in changes] == [1, 2, 3, 4]
    assert made.since(2) == changes[2:]
    assert made.since(4) == []


def test_after_too_long_a_gap_or_of_another_gateway_everything_comes_anew():
    made = story()
    for n in range(MAX_CHANGES + 5):
        made.take(note(n + 1, float(n), m.Phase.EXECUTING))
        made.flush()
    for asked in (0, 3, MAX_CHANGES + 99):
        (text,) = made.since(asked)
        snapshot = msgspec.json.decode(text)["snapshot"]
        assert (snapshot["n"], [row["command"] for row in snapshot["rows"]]) == (MAX_CHANGES + 5, ["C-1"])


def test_refusals_and_halts_are_lines():
    made = story()
    refusal = Refusal(reason=RefusalReason.OVERLOAD, message="full")
    made.take(m.RequestRefused(at_s=1.0, request="r", refusal=refusal, text="STOW"))
    made.take(m.HaltRequested(at_s=2.0, halt="H-1", scope="ALL"))
    assert [(line.kind, line.words) for line in made.lines] == [("refusal", "full"), ("halt", "HALT ALL")]


def test_the_oldest_ended_commands_are_forgotten():
    made = story()
    for n in range(1, MAX_ROWS + 10):
        made.take(ended(n, float(n), f"C-{n}"))
    assert len(made.rows) == MAX_ROWS
    assert "C-1" not in made.rows
