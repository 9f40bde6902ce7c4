"""Stdout that is full, closed, or without a reader: reported once, in a sentence, with the right exit status."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest

from rtc.apps.cli import sentences
from rtc.apps.cli.halt import print_halt
from rtc.apps.cli.progress import Board
from rtc.apps.cli.sentences import gone_away
from rtc.apps.cli.stdio import OutputClosed, OutputStream
from rtc.client.halt import HaltResult
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind


def without_reader() -> io.TextIOWrapper:
    """A pipe whose reader has gone."""
    read, write = os.pipe()
    os.close(read)
    return os.fdopen(write, "w")


def to_a_full_disk() -> io.TextIOWrapper:
    return os.fdopen(os.open("/dev/full", os.O_WRONLY), "w")


def test_what_is_printed_is_written() -> None:
    written = io.StringIO()
    output = OutputStream(written)
    output.write("C-7 SUCCEEDED\n")
    output.flush()
    assert written.getvalue() == "C-7 SUCCEEDED\n"


@pytest.mark.parametrize(
    ("stream", "gone", "words"),
    [
        (without_reader, True, "the reader of stdout has closed it"),
        (to_a_full_disk, False, "cannot print: No space left on device"),
        (lambda: None, False, "cannot print: stdout is closed"),
    ],
)
def test_a_loss_is_reported_once_and_the_rest_is_dropped(stream, gone: bool, words: str) -> None:
    output = OutputStream(stream())
    with pytest.raises(OutputClosed, match=words) as closed:
        print("one", file=output, flush=True)
    assert closed.value.reader_gone == gone

    output.write("two\n")
    output.flush()
    output.close()  # nothing is left in a buffer that could fail when Python ends


def test_the_loss_of_an_optional_stream_is_not_reported() -> None:
    output = OutputStream(to_a_full_disk(), needed=False)
    output.write("one\n")
    output.flush()


def ended(command: str) -> m.CommandEnded:
    outcome = Outcome(kind=OutcomeKind.FAILED)
    return m.CommandEnded(seq=1, at_s=0, command=command, request="r", text="", outcome=outcome, took_s=1.0)


def test_after_the_loss_of_stdout_stderr_names_what_continues(capsys: pytest.CaptureFixture[str]) -> None:
    board = Board(["STOW LEFT-ARM", "STOW RIGHT-ARM"], quiet=True)
    board.accepted(0, "C-7")
    assert gone_away(OutputClosed(BrokenPipeError()), board, 1) == sentences.LEFT_RUNNING
    assert "left running: C-7; rtc halt C-7\n" in capsys.readouterr().err

    board.ended(0, ended("C-7"))
    assert gone_away(OutputClosed(BrokenPipeError()), board, 1) == 1  # it failed
    assert "left running" not in capsys.readouterr().err
    gone_away(OutputClosed(BrokenPipeError()), board, 2)
    assert "not sent: 1 more" in capsys.readouterr().err


def test_a_halt_is_reported_on_stderr_when_stdout_is_lost(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = HaltResult(
        halt="H-1",
        scope="ALL",
        latency_s=None,
        confirmed=False,
        sent_to=["halt"],
        subsystems=[],
        message="no subsystem answered",
    )
    monkeypatch.setattr(sys, "stdout", OutputStream(None))
    print_halt(result)
    assert "no subsystem answered" in capsys.readouterr().err


def rtc(words: str) -> subprocess.CompletedProcess[str]:
    line = f'"$0" -P -m rtc.apps.cli.main {words}'
    return subprocess.run(["bash", "-c", line, sys.executable], capture_output=True, text=True, timeout=60)


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ("grammar | head -1 >/dev/null; exit ${PIPESTATUS[0]}", 0, ""),
        ("dictionary >/dev/full", 1, "rtc: cannot print: No space left on device\n"),
        ("dictionary >&-", 1, "rtc: cannot print: stdout is closed\n"),
        ("-h >/dev/full", 1, "rtc: cannot print: No space left on device\n"),
        (
            "status --json --run-dir /nowhere >/dev/full",
            4,
            "rtc: no cluster in /nowhere; start one with: rtc up -d --run-dir /nowhere\n",
        ),
        ("dictionary >/dev/null 2>&- <&-", 0, ""),
    ],
)
def test_a_lost_stdout_is_a_sentence_and_a_status(words: str, status: int, message: str) -> None:
    done = rtc(words)
    assert (done.returncode, done.stderr) == (status, message)


def test_what_the_encoding_lacks_is_printed_with_a_sign_in_its_place() -> None:
    """`rtc do` ended with "this is not text" while its command ran, and `rtc log` printed nothing."""
    code = "import sys; from rtc.apps.cli.stdio import attach; attach(); print('f\\u00fcr'); sys.stdout.flush()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"}, check=False
    )
    assert (done.returncode, done.stdout) == (0, b"f?r\n"), done.stderr
