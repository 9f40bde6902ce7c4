"""Exit codes and what a refusal looks like."""

from __future__ import annotations

import fcntl
import io
import json
import time
from pathlib import Path

import msgspec
import pytest
from rich.table import Table
from rich.text import Text

from rtc.apps.cli.output import EXIT, Screen, emit_json, exit_code
from rtc.apps.cli.status import as_supervised, show_status
from rtc.language.parse import default_grammar, parse
from rtc.protocol import causes
from rtc.protocol.advice import Alternative, by_person, by_sentence
from rtc.protocol.messages import ProcessRow, RefusedPeerRow, Status, WorkerRow
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason
from rtc.wording.measured import seconds
from rtc.wording.refusals import refusal_lines
from rtc.wording.sentences import quoted


@pytest.mark.parametrize(
    ("kinds", "code"),
    [
        ([], 0),
        ([OutcomeKind.SUCCEEDED], 0),
        ([OutcomeKind.SUCCEEDED, OutcomeKind.REFUSED], 2),
        ([OutcomeKind.REFUSED, OutcomeKind.FAILED], 1),
        ([OutcomeKind.LOST_SUBSYSTEM], 1),
        ([OutcomeKind.FAILED, OutcomeKind.HALTED, OutcomeKind.REFUSED], 3),
        ([OutcomeKind.HALT_NOT_CONFIRMED], 3),
    ],
)
def test_the_worst_of_several_decides_the_exit_code(kinds: list[OutcomeKind], code: int) -> None:
    assert exit_code(kinds) == code


def test_every_kind_of_outcome_has_an_exit_code() -> None:
    assert set(EXIT) == set(OutcomeKind)


def test_a_wrong_sentence_has_a_caret_under_the_wrong_word() -> None:
    text = "STOW LEFT-LEG"
    refusal = parse(default_grammar(), text)
    assert isinstance(refusal, Refusal)

    line, caret, *_ = refusal_lines(refusal, text)

    assert line[caret.index("^") :] == "LEFT-LEG"


def test_a_refusal_names_the_owner_and_what_would_clear_it() -> None:
    refusal = Refusal(
        reason=RefusalReason.RESOURCE,
        message="RIGHT-ARM is taken",
        owner="C-3",
        clears=by_person("wait for C-3"),
        cause=causes.BeyondStop(value_rad=0.0, least_rad=0.0, most_rad=2.7925268),
    )
    assert refusal_lines(refusal, details=True) == [
        "RIGHT-ARM is taken",
        "owner: C-3",
        "figures: cause stop, value 0 deg, least 0 deg, most 160 deg",
        "to clear it: wait for C-3",
    ]


def test_several_alternatives_have_the_numbers_by_which_they_are_followed() -> None:
    clears = [Alternative(sentences=["LOCATE X"], again=True), *by_sentence("STOW A", instead=True), *by_person("wait")]
    refusal = Refusal(reason=RefusalReason.STATE, message="no way", clears=clears)
    lines = refusal_lines(refusal)
    assert [line.split()[0] for line in lines[-3:]] == ["1.", "2.", "3."]
    assert ["LOCATE X" in lines[-3], "STOW A" in lines[-2], "wait" in lines[-1]] == [True] * 3


def test_figures_do_not_repeat_the_message() -> None:
    cause, effort = causes.OutOfReach(arm="RIGHT-ARM", which="ARM", distance_m=0.37), causes.Effort(candidates=2)
    message = "RIGHT-ARM: 2 of them, after 375 mm"
    refusal = Refusal(reason=RefusalReason.STATE, message=message, cause=cause, along_m=0.375, effort=effort)
    assert refusal_lines(refusal, details=True)[1:] == [
        "figures: cause reach, which ARM, distance 370 mm, candidates 2"
    ]


def test_a_sentence_is_repeated_in_one_short_line_that_does_nothing_to_the_screen() -> None:
    assert quoted("GRASP \x1b[31mMACS-NEW\nSTOW \udcff") == "GRASP \u241b[31mMACS-NEW\u240aSTOW \ufffd"
    assert len(quoted("A" * 10_000)) <= 200


@pytest.mark.parametrize(
    ("value", "text"), [(0.00042, "0.42 ms"), (0.0371, "37 ms"), (0.9996, "1000 ms"), (2.154, "2.15 s")]
)
def test_durations_are_readable(value: float, text: str) -> None:
    assert seconds(value) == text


def test_a_worker_of_another_machine_is_among_the_processes(capsys) -> None:
    mine = ProcessRow(name="binder@2", node=2, pid=7, state="ready")
    workers = [WorkerRow(name=name, node=node, done=3) for name, node in (("binder@2", 2), ("binder@18", 18))]
    show_status(Status(processes=[mine], workers=workers))
    printed = capsys.readouterr().out
    assert "binder@18" in printed
    assert "ready, elsewhere" in printed
    assert printed.count("binder@2 ") == 1


def test_without_a_broker_the_supervisors_report_is_what_is_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It knows nothing of commands, so it must not report that none is in progress."""
    assert as_supervised(tmp_path) is None
    rows = [{"name": "broker", "pid": 7, "state": "starting", "restarts": 3, "since_s": 0.0, "node": None, "notes": []}]
    report = {"pid": 1, "cluster": "abc", "started_at": time.time() - 5, "processes": rows}
    (tmp_path / "supervisor.json").write_text(json.dumps(report))
    with open(tmp_path / "supervisor.lock", "w") as lock:
        assert as_supervised(tmp_path) is None  # it was killed: its report means nothing
        fcntl.flock(lock, fcntl.LOCK_EX)
        known = as_supervised(tmp_path)
    assert known is not None

    show_status(known, silent=True)
    printed = capsys.readouterr().out
    assert printed.startswith(f"cluster abc in {tmp_path}, up 5.")
    assert "starting" in printed
    assert "no command" not in printed


def test_a_refused_peer_is_shown_with_both_versions(capsys: pytest.CaptureFixture[str]) -> None:
    words = "binder@18 speaks version 3 of the protocol, this cluster version 2"
    peer = RefusedPeerRow(name="binder@18", socket="workers", protocol=3, message=words, ago_s=7.0)
    show_status(Status(refused=[peer]))
    assert words in " ".join(capsys.readouterr().out.split())


def test_names_from_outside_do_nothing_to_the_terminal() -> None:
    """The argument of rtc halt, a subsystem's performers, labels of a loaded program: whatever is printed."""
    evil = "ARM\x1b]0;title\x07\x1b[2J\x9b31m"
    row = Table()
    row.add_row(evil)
    out = io.StringIO()
    screen = Screen(file=out, force_terminal=True, color_system="standard", width=80, highlight=False)
    for it in (evil, Text(f"HALT {evil}: \nwell", style="bold"), row):
        screen.print(it, markup=False)
    for own in ("\x1b[1m", "\x1b[0m"):  # of the style
        assert own in out.getvalue()
    shown = out.getvalue().replace("\x1b[1m", "").replace("\x1b[0m", "")
    assert not [c for c in shown if not c.isprintable() and c != "\n"]
    assert "ARM\u241b]0;title" in shown
    assert "\nwell\n" in shown


def test_json_does_nothing_to_the_terminal_and_stays_what_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    evil = {"performers": "ARM\x1b[2J\x9b31m\x7f\u202e \u00e9 \U0001f600 \U000e0001"}
    emit_json(evil)
    line = capsys.readouterr().out.removesuffix("\n")
    assert line.isprintable()
    assert json.loads(line) == evil


def test_a_refusal_names_what_it_proposes_once() -> None:
    names = ["HANDLE-A", "HANDLE-B"]
    refusal = Refusal(
        reason=RefusalReason.NAME,
        message="there is no grasp point of MACS-OLD HANDLE-C",
        nearest=names,
        expected=names,
        clears=by_person("did you mean HANDLE-A or HANDLE-B?"),
    )
    assert "\n".join(refusal_lines(refusal)).count("HANDLE-A") == 1
    more = msgspec.structs.replace(refusal, expected=[*names, "OTHER"])
    assert "OTHER" in "\n".join(refusal_lines(more))
