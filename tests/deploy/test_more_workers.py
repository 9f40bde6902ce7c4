"""The command line for more workers: refused before it could be useless, and run beside the supervisor."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from pathlib import Path

import msgspec
import pytest

from deploy.more_workers import RUN_LIMIT_S, MoreCommand, check_more
from rtc.protocol.messages import RequestWorkers, WorkerKind, WorkerRequest
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.process import now_s
from rtc.runtime.settings import Settings

ORDER = RequestWorkers(kind=WorkerKind.BINDER, count=4, registered_before=1)
LIMIT_S = 30.0
PAUSE = threading.Event()
PYTHON = f"{sys.executable} -S -E -c"


def settings(more: str, listen: str = "tcp://127.0.0.1:5555") -> Settings:
    return Settings(run_dir="/nowhere", more=more, listen=listen)


@pytest.mark.parametrize("options", [{"scale_out_max": 4}, {"scale_out_timeout_s": 5.0}])
def test_options_of_more_without_a_command_line_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ClusterError, match="without --more"):
        check_more(msgspec.structs.replace(settings(""), **options))
    check_more(settings(""))


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("sh more.sh {kind} {number}", "{kind} and {count}"),
        ("sh more.sh {kind} {}", "{kind} and {count}"),
        ("sh more.sh {kind} {count:03d}", "{kind} and {count}"),
        ("sh more.sh {kind} {count.real}", "{kind} and {count}"),
        ("sh more.sh {kind} {", "{{"),
        ("sh more.sh {count}", "{kind}"),
        ("sh 'more.sh {kind}", "No closing quotation"),
        ("   ", "leave it out"),
        ("no-such-command-of-ours {kind}", "full path"),
    ],
)
def test_a_command_line_that_could_do_nothing_is_refused(line: str, advice: str) -> None:
    with pytest.raises(ClusterError) as refused:
        check_more(settings(line))
    assert advice in str(refused.value)


def test_without_ports_for_other_machines_it_is_refused() -> None:
    with pytest.raises(ClusterError, match="--listen"):
        check_more(settings("sh {kind}", listen=""))


def test_braces_of_the_command_itself_are_doubled() -> None:
    check_more(settings("sh -c 'echo {{x}} {kind} {count}'"))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "more.log"


def ended(command: MoreCommand) -> tuple[str, WorkerRequest]:
    """Wait for the end of the run: (words for people, what is reported)."""
    assert select.select([command.exited_fd], [], [], LIMIT_S)[0]
    return command.reap(), command.asked()[0]


def test_a_run_gets_kind_and_count_and_its_last_line_is_kept(log: Path) -> None:
    command = MoreCommand(f"{PYTHON} 'import sys; print(sys.argv[1:]); print()' {{kind}} 1-{{count}}", log)
    assert "4 binders" in command.start(ORDER)
    assert command.asked()[0].running

    words, asked = ended(command)

    assert (words, asked.running, asked.failed) == ("", False, "")
    assert (asked.count, asked.registered_before, asked.output) == (4, 1, "['binder', '1-4']")
    assert command.exited_fd == -1


def test_a_failure_is_reported_with_its_last_line(log: Path) -> None:
    log.write_text("of an earlier run\n")
    command = MoreCommand(f"{PYTHON} 'import sys; sys.exit(\"no such partition\")' {{kind}}", log)
    command.start(ORDER)
    words, asked = ended(command)
    assert (asked.failed, asked.output) == ("ended with status 1", "no such partition")
    assert "no such partition" in words

    command = MoreCommand(f"{PYTHON} 'raise SystemExit(3)' {{kind}}", log)
    command.start(ORDER)
    assert ended(command)[1].output == ""  # the line above belongs to another run


def test_a_command_that_has_vanished_is_a_failed_run(log: Path) -> None:
    command = MoreCommand("/nowhere/more {kind}", log)
    assert "cannot be started" in command.start(ORDER)
    assert command.asked()[0].failed
    assert (command.pid, command.exited_fd) == (0, -1)


def test_one_run_at_a_time(log: Path) -> None:
    command = MoreCommand(f"{PYTHON} 'import signal; signal.pause()' {{kind}}", log)
    command.start(ORDER)
    pid = command.pid
    assert command.start(RequestWorkers(kind=WorkerKind.PARSER, count=1, registered_before=0)) == ""
    assert command.pid == pid
    command.end()
    assert ended(command)[1].kind is WorkerKind.BINDER


def test_a_run_that_does_not_end_is_ended_but_not_what_it_has_started(log: Path) -> None:
    """A script that starts a worker in the background and then hangs."""
    code = (
        "import os, signal, sys; signal.signal(signal.SIGTERM, signal.SIG_IGN); pid = os.fork()\n"
        "print(pid, flush=True) if pid else None\n"
        "signal.pause()"
    )
    command = MoreCommand(f'{PYTHON} "{code}" {{kind}}', log)
    command.start(ORDER)
    end_s = now_s() + LIMIT_S
    while not log.read_text().endswith("\n"):
        assert now_s() < end_s
        PAUSE.wait(0.01)
    worker = os.pidfd_open(int(log.read_text()))
    try:
        command.end_overdue(now_s())
        command.end_overdue(now_s() + 2 * RUN_LIMIT_S)  # SIGTERM, which it ignores
        command.end_overdue(now_s() + 3 * RUN_LIMIT_S)

        assert "time limit" in ended(command)[1].failed
        assert not select.select([worker], [], [], 0)[0]  # it lives
    finally:
        signal.pidfd_send_signal(worker, signal.SIGKILL)
        os.close(worker)
