"""Commands in a process that the cluster forks: they do what those in a process of their own do."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.cli import forked
from rtc.apps.cli import template as template_process
from rtc.apps.cli.forked import SOCKET, Call
from rtc.apps.demos.own_cluster import own_cluster
from rtc.runtime.process_table import Table
from tests.apps.cli.in_process import call

LIMIT_S = 60.0
SLOW_TO_IMPORT = {"typer", "rich", "numpy", "pinocchio", "lark", "msgspec", "zmq", "yaml"}
#: `rtc`; at its end the modules that its own process has loaded, on stderr
LISTED = """
import sys
from rtc.apps.cli import entry
try:
    entry.main()
finally:
    print(*sys.modules, file=sys.stderr)
"""
OTHER_USER = 65534
SHORT = "HOLD LEFT-ARM FOR 0.01 SEC"
LONG = "HOLD RIGHT-ARM FOR 100 SEC"


def test_a_call_arrives_as_it_was_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environb, b"RTC_ODD", b"a=b\n\xff")
    made = Call(["do", "WAIT\n1 SEC", "", "\udcff"])
    read = Call.from_bytes(made.to_bytes())
    assert vars(read) == vars(made)


def test_a_call_that_is_cut_off_is_none() -> None:
    data = Call(["status"]).to_bytes()
    assert is_call(data)
    assert not any(is_call(data[:end]) for end in range(0, data.index(b"status"), 7))


def is_call(data: bytes) -> bool:
    try:
        Call.from_bytes(data)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("background", [False, True])
def test_in_the_background_of_a_terminal_nothing_is_forked(background: bool) -> None:
    """There the kernel stops a process that reads; it would not stop one without a controlling terminal."""
    pid, terminal = pty.fork()
    if pid == 0:  # a session leader, whose group is in the foreground
        if (inner := os.fork()) == 0:
            if background:
                os.setpgid(0, 0)
            os._exit(forked._in_foreground())
        os._exit(os.waitstatus_to_exitcode(os.waitpid(inner, 0)[1]))
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    os.close(terminal)
    assert bool(status) != background


@pytest.mark.slow
@pytest.mark.untimed
def test_without_an_answer_the_caller_runs_the_command_and_no_other_does(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(tmp_path / SOCKET))
        listener.listen()
        status, _, errors = ended(started(tmp_path, "status"))
        line, _ = listener.accept()
        with line:
            assert Call.from_bytes(line.recv(1 << 20)).words == ["status"]
            assert line.recv(1) == b""  # not the byte upon which a forked process begins
    assert status == 4, errors  # there is no cluster
    assert "typer" in errors.splitlines()[-1].split()


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")
def test_the_environment_goes_to_no_other_user(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path.parent):
        directory.chmod(0o711)
    os.chown(tmp_path, OTHER_USER, OTHER_USER)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(tmp_path / SOCKET))
        if (other := os.fork()) == 0:  # whose listener it is: the credentials are those at this moment
            os.setuid(OTHER_USER)
            listener.listen()
            os._exit(0)
        assert os.waitpid(other, 0)[1] == 0
        status, _, errors = ended(started(tmp_path, "status"))
        line, _ = listener.accept()
        with line:
            assert line.recv(1 << 20) == b""
    assert status == 4, errors  # there is no cluster


def test_a_change_of_the_grammar_is_one_of_the_code() -> None:
    assert all(Path(file).is_file() for file in template_process._files())
    assert "command.lark" in {Path(file).name for file in template_process._files()}


# --- with a cluster ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="kinematic") as made:
        yield made


def started(run_dir: Path, *words: str, code: str = LISTED, **about: object) -> subprocess.Popen[str]:
    environment = {**os.environ, "RTC_RUN_DIR": str(run_dir)}
    command = [sys.executable, "-P", "-c", code, *words]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(command, env=environment, text=True, **pipes, **about)  # type: ignore[call-overload]


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """(exit status, stdout, stderr)"""
    output, errors = process.communicate(timeout=LIMIT_S)
    return process.returncode, output, errors


def executing(run_dir: Path) -> tuple[subprocess.Popen[str], int]:
    """`rtc do` of a long command that executes, and the forked process of it."""
    process = started(run_dir, "do", LONG)
    assert process.stdout is not None
    for line in process.stdout:
        if "executing" in line:
            return process, forked_process(run_dir)
    raise AssertionError(ended(process))


def template(run_dir: Path) -> int:
    return next(row.pid for row in Table.load(run_dir).processes if row.name == "cli-template")


def forked_process(run_dir: Path) -> int:
    children = Path(f"/proc/{(pid := template(run_dir))}/task/{pid}/children").read_text().split()
    (found,) = [int(child) for child in children if Path(f"/proc/{child}/comm").read_text() == "rtc do\n"]
    return found


@contextlib.contextmanager
def end_awaited(pid: int) -> Iterator[None]:
    """That process ends within the limit after the block."""
    watch = os.pidfd_open(pid)
    try:
        yield
        assert select.select([watch], [], [], LIMIT_S)[0]
    finally:
        os.close(watch)


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize("words", [["status"], ["why", "C-1"], ["parse", "GIVE"], ["names", "places"], ["test", LONG]])
def test_the_process_that_is_called_loads_no_library(run_dir: Path, words: list[str]) -> None:
    _, output, errors = ended(started(run_dir, *words))
    loaded = errors.splitlines()[-1].split()
    assert "rtc.apps.cli.forked" in loaded
    assert not SLOW_TO_IMPORT & set(loaded)
    assert output or len(errors.splitlines()) > 1


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize(
    "words", [["parse", "GIVE"], ["dictionary", "GRASP"], ["do"], ["names", "-h"], ["why", "C-77"]]
)
def test_the_result_is_that_of_a_process_of_its_own(
    run_dir: Path, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RTC_RUN_DIR", str(run_dir))
    own = call(*words)
    status, output, errors = ended(started(run_dir, *words, code="from rtc.apps.cli import entry; entry.main()"))
    assert (status, output, errors) == (own.returncode, own.stdout, own.stderr)


@pytest.mark.slow
@pytest.mark.untimed
def test_files_are_those_of_the_directory_in_which_it_is_called(run_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "one.txt").write_text(f"{SHORT}\n")
    status, output, errors = ended(started(run_dir, "do", "--file", "one.txt", cwd=tmp_path))
    assert (status, "SUCCEEDED" in output) == (0, True), output + errors


@pytest.mark.slow
@pytest.mark.untimed
def test_a_file_that_only_the_caller_has_open_is_read(run_dir: Path) -> None:
    """As of `rtc do --file <(...)`."""
    source, sink = os.pipe()
    os.write(sink, f"{SHORT}\n".encode())
    os.close(sink)
    status, output, errors = ended(started(run_dir, "do", "--file", f"/dev/fd/{source}", pass_fds=[source]))
    os.close(source)
    assert (status, "SUCCEEDED" in output) == (0, True), output + errors


@pytest.mark.slow
@pytest.mark.untimed
def test_a_signal_reaches_the_command(run_dir: Path) -> None:
    process, command = executing(run_dir)
    with end_awaited(command):
        process.send_signal(signal.SIGTERM)
        assert ended(process)[0] == 128 + signal.SIGTERM
    assert call("halt", "--run-dir", str(run_dir)).returncode == 0


@pytest.mark.slow
@pytest.mark.untimed
def test_a_caller_that_is_killed_takes_the_command_with_it(run_dir: Path) -> None:
    process, command = executing(run_dir)
    with end_awaited(command):
        process.kill()
        process.communicate(timeout=LIMIT_S)
    assert call("halt", "--run-dir", str(run_dir)).returncode == 0


@pytest.mark.slow
@pytest.mark.untimed
def test_a_stopped_command_ends_with_its_caller(run_dir: Path) -> None:
    process, command = executing(run_dir)
    with end_awaited(command):
        os.kill(command, signal.SIGSTOP)
        process.kill()
        process.communicate(timeout=LIMIT_S)
    assert call("halt", "--run-dir", str(run_dir)).returncode == 0


@pytest.mark.slow
@pytest.mark.untimed
def test_without_a_shell_that_could_continue_it_the_caller_is_not_stopped(run_dir: Path) -> None:
    """Ctrl-Z in `ssh -t HOST rtc do ...`."""
    process = started(run_dir, "do", "HOLD LEFT-ARM FOR 1 SEC", start_new_session=True)
    assert process.stdout is not None
    assert any("executing" in line for line in process.stdout)
    process.send_signal(signal.SIGTSTP)
    assert ended(process)[0] == 0


@pytest.mark.slow
@pytest.mark.untimed
def test_a_command_that_is_killed_is_an_error_of_the_caller(run_dir: Path) -> None:
    process, command = executing(run_dir)
    os.kill(command, signal.SIGKILL)
    status, _, errors = ended(process)
    assert status == 1
    assert len(errors.splitlines()) == 2  # the error, and the modules
    assert call("halt", "--run-dir", str(run_dir)).returncode == 0


@pytest.mark.slow
@pytest.mark.untimed
def test_other_code_and_what_is_no_call_are_declined(run_dir: Path) -> None:
    other = Call(["status"])
    other.code = [*other.code[:-1], "/another/path"]
    for data in (other.to_bytes(), b"", b"\0\0", bytes(range(256)), Call(["status"]).to_bytes()[:9]):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as line:
            line.settimeout(LIMIT_S)
            line.connect(str(run_dir / SOCKET))
            line.send(data)
            assert line.recv(32) == b""
    assert ended(started(run_dir, "status"))[0] == 0
