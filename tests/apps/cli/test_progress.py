"""The board off a terminal: one line per change, one result per sentence."""

from __future__ import annotations

import io

from rich.console import Console

from rtc.apps.cli.progress import REPORTS_KEPT, Board, print_result
from rtc.protocol import causes
from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Measured, Outcome, OutcomeKind, Refusal, RefusalReason, StopReason
from rtc.wording.refusals import refusal_lines

CURSOR_UP = "\x1b[1A"


def plain() -> tuple[Console, io.StringIO]:
    text = io.StringIO()
    return Console(file=text, soft_wrap=True, color_system=None), text


def ended(outcome: Outcome) -> m.CommandEnded:
    return m.CommandEnded(seq=1, at_s=0, command="C-7", request="r", text="", outcome=outcome, took_s=2.0)


def test_a_change_is_a_line_and_no_change_is_none() -> None:
    out, text = plain()
    note = m.ProgressNote(seq=1, at_s=0, command="C-7", phase=m.Phase.EXECUTING, step="1 of 2: go", node="binder@2")
    with Board(["STOW LEFT-ARM"], out=out) as board:
        board.accepted(0, "C-7")
        board.progress(note)
        board.progress(note)
        assert board.running == ["C-7"]
        board.ended(0, ended(Outcome(kind=OutcomeKind.SUCCEEDED, steps_done=2)))
        assert board.running == []

    lines = text.getvalue().splitlines()
    assert [line.split(" s  ")[-1] for line in lines] == [
        "C-7  accepted  STOW LEFT-ARM",
        "C-7  executing   1 of 2: go",
        "C-7 SUCCEEDED  STOW LEFT-ARM  (2 steps, 2.00 s)",
    ]


def test_a_step_says_how_long_it_takes_and_reports_are_lines_of_their_own() -> None:
    out, text = plain()
    step = {"seq": 1, "at_s": 0.0, "command": "C-7", "phase": m.Phase.EXECUTING, "step": "1 of 1: go"}
    with Board(["STOW LEFT-ARM REPORT EVERY 1 SEC"], out=out) as board:
        board.accepted(0, "C-7")
        board.progress(m.ProgressNote(**step, expected_s=4.2))
        board.progress(m.ProgressNote(**{**step, "seq": 0}, measured=Measured(arm="LEFT-ARM", joints=[0.0])))
        board.progress(m.ProgressNote(**step))

    lines = [line.split(" s  ", 1)[-1] for line in text.getvalue().splitlines()]
    assert lines[1:] == ["C-7  executing   1 of 1: go  about 4.2 s", "C-7  LEFT-ARM joints: 0.0 deg"]
    assert [report.measured.joints for report in board.reports["C-7"]] == [[0.0]]


def test_a_condition_that_was_met_is_a_line_and_old_reports_are_counted() -> None:
    out, text = plain()
    measured = Measured(arm="LEFT-ARM", joints=[0.0])
    note = m.ProgressNote(
        seq=0,
        at_s=0.0,
        command="C-7",
        phase=m.Phase.EXECUTING,
        kind=m.NoteKind.CONDITION,
        message="FORCE EXCEEDS 5 N",
        value=6.0,
        unit="N",
        measured=measured,
    )
    with Board(["X"], out=out) as board:
        board.accepted(0, "C-7")
        board.progress(note)
        board.quiet = True
        for _ in range(REPORTS_KEPT):
            board.progress(note)

    assert [line.split(" s  ", 1)[-1] for line in text.getvalue().splitlines()[1:]] == [
        "C-7  FORCE EXCEEDS 5 N: 6 N; LEFT-ARM joints: 0.0 deg",
    ]
    assert (len(board.reports["C-7"]), board.reports_older["C-7"]) == (REPORTS_KEPT, 1)


def test_a_warning_is_a_line_although_the_phase_passes() -> None:
    out, text = plain()
    note = {"seq": 1, "at_s": 0.0, "command": "C-7", "phase": m.Phase.ELABORATING}
    with Board(["LIFT X"], out=out) as board:
        board.accepted(0, "C-7")
        board.progress(m.ProgressNote(**note, kind=m.NoteKind.PLANNED, message="it is late", warning=True))
    assert text.getvalue().splitlines()[1:] == ["C-7  warning: it is late"]


def test_what_was_measured_stands_below_the_result() -> None:
    out, text = plain()
    outcome = Outcome(kind=OutcomeKind.SUCCEEDED, measured=Measured(arm="LEFT-ARM", joints=[0.0]))
    print_result(ended(outcome), "X", out)
    assert text.getvalue().splitlines()[1:] == ["    LEFT-ARM joints: 0.0 deg"]


def test_notes_of_other_commands_are_not_shown() -> None:
    out, text = plain()
    with Board(["STOW LEFT-ARM"], out=out) as board:
        board.progress(m.ProgressNote(seq=1, at_s=0, command="C-99", phase=m.Phase.BINDING))
    assert text.getvalue() == ""


def test_a_failure_says_the_step_the_reason_and_the_trims() -> None:
    out, text = plain()
    outcome = Outcome(
        kind=OutcomeKind.FAILED,
        message="a finger landed on the handle",
        step="4 of 9: straddle",
        stop=StopReason.FORCE_LIMIT,
        trims=["look again"],
    )
    print_result(ended(outcome), "GRASP X", out)
    assert text.getvalue().splitlines() == [
        "C-7 FAILED  GRASP X  (2.00 s)",
        "    a finger landed on the handle",
        "    in step 4 of 9: straddle, stopped by force_limit",
        "    tried on the way: look again",
    ]


def test_the_cause_precedes_the_step_and_the_advice_and_names_and_figures_of_planning_are_left_out() -> None:
    out, text = plain()
    refusal = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message="GOAL: too far by 104627 mm",
        where="move.plan[0] (GOAL)",
        cause=causes.OutOfReach(arm="LEFT-ARM", which="", distance_m=104.627),
        effort=causes.Effort(ways_tried=5),
        clears=by_person("another goal"),
    )
    outcome = Outcome(
        kind=OutcomeKind.FAILED, message=refusal.message, refusal=refusal, step="1 of 1: move", stop=StopReason.TIMEOUT
    )
    print_result(ended(outcome), "MOVE X", out)
    assert text.getvalue().splitlines()[1:] == [
        "    GOAL: too far by 104627 mm",
        "    in step 1 of 1: move, stopped by timeout",
        "    to clear it: another goal",
    ]
    assert "figures: cause reach, arm LEFT-ARM, ways_tried 5" in refusal_lines(refusal, details=True)


def test_a_sentence_with_markup_in_it_is_shown_as_it_is() -> None:
    out, text = plain()
    refusal = Refusal(reason=RefusalReason.SENTENCE, message="[bold]no[/bold]", column=0)
    print_result(ended(Outcome(kind=OutcomeKind.REFUSED, refusal=refusal, message=refusal.message)), "[red]X", out)
    assert text.getvalue().splitlines() == [
        "C-7 REFUSED  [red]X  (2.00 s)",
        "      [red]X",
        "      ^",
        "    [bold]no[/bold]",
    ]


def test_what_was_printed_during_a_pause_is_not_overwritten() -> None:
    screen = io.StringIO()
    with Board(["HOLD LEFT-ARM"], out=Console(file=screen, force_terminal=True, width=100)) as board:
        board.accepted(0, "C-1")
        board.pause()
        begun = screen.tell()
        screen.write("an answer\n")
        board.resume()
        assert CURSOR_UP not in screen.getvalue()[begun:]
