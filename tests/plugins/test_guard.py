"""The guard round code of packages: no exception, odd value or fork of it gets out, and each failure has its name."""

from __future__ import annotations

import fractions
import os
import select
import signal
import time

import pytest

from rtc.plugins import guard, registry
from rtc.plugins.guard import PluginError, guarded
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.runtime.memory_guard import limit_data
from tests.plugins.toy_packages import Install


class Mute(Exception):
    def __str__(self) -> str:
        raise ValueError("not even that")


class MuteToTheEnd(Exception):
    def __str__(self) -> str:
        raise SystemExit


def nameless() -> Exception:
    """Its class has no name. Made where it is used: pytest asks each class of a module for its names."""

    class Nameless(type):
        def __getattribute__(cls, name: str):
            raise SystemExit

    return Nameless("Odd", (Exception,), {})()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (SystemExit(3), "SystemExit: 3"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (GeneratorExit(), "GeneratorExit"),
        (RecursionError("deep"), "RecursionError: deep"),
        (Mute(), "Mute"),
        (MuteToTheEnd(), "MuteToTheEnd"),
        (nameless(), "an exception without a name"),
        (RuntimeError("\x1b[31m" + "x" * 100_000), "RuntimeError:  [31mxx"),
    ],
)
def test_every_exception_becomes_a_short_printable_one_that_names_the_code(error, words, monkeypatch) -> None:
    monkeypatch.setattr(signal, "getsignal", lambda _: signal.SIG_IGN)  # as in a process of a cluster
    with pytest.raises(PluginError) as caught, guarded("phase CHECKED"):
        raise error
    text = str(caught.value)
    assert text.startswith(f"the phase CHECKED of an installed package has failed: {words}")
    assert len(text) < 300
    assert text.isprintable()


def test_the_ctrl_c_of_a_person_and_a_refusal_pass() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have started the tests without it
    try:
        with pytest.raises(KeyboardInterrupt), guarded("phase CHECKED"):
            raise KeyboardInterrupt
    finally:
        signal.signal(signal.SIGINT, before)
    with pytest.raises(Refused), guarded("phase CHECKED"):
        raise Refused.because(RefusalReason.STATE, "not today")


def test_a_process_that_the_code_forks_does_not_leave_the_block() -> None:
    with guarded("phase CHECKED"):
        child = os.fork()
    assert child  # the child has ended instead of coming here
    assert os.waitpid(child, 0)[1] == 0


def test_a_process_that_stays_in_the_block_ends_with_its_parent() -> None:
    read, write = os.pipe()
    parent = os.fork()
    if parent == 0:
        with guarded("phase CHECKED"):
            if os.fork() == 0:
                os.write(write, f"{os.getpid()}\n".encode())
                signal.pause()
            signal.pause()
    grandchild = int(os.read(read, 32))
    pidfd = os.pidfd_open(grandchild)
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    assert select.select([pidfd], [], [], 10.0)[0]
    for fd in (pidfd, read, write):
        os.close(fd)


def test_a_failure_names_the_file_and_the_line() -> None:
    words = r"ZeroDivisionError.* \(.*fractions\.py, line \d+\)"
    with pytest.raises(PluginError, match=words), guarded("phase CHECKED", fractions.__file__):
        fractions.Fraction(1, 0)


def test_what_was_cut_off_is_not_called_again_in_the_same_job() -> None:
    with pytest.raises(PluginError), guarded("phase CHECKED", limit_s=0.02):
        time.sleep(600.0)
    with pytest.raises(PluginError), guarded("phase CHECKED"):
        pytest.fail("it was called")
    guard.begin_anew()
    with guarded("phase CHECKED"):
        pass


def test_code_that_takes_memory_without_end_fails_like_any_other() -> None:
    child = os.fork()
    if child == 0:
        limit_data()
        try:
            with guarded("phase CHECKED"):
                bytearray(12_000_000_000)
        except PluginError as error:
            os._exit(7 if "MemoryError" in str(error) else 1)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


def test_a_witness_receives_what_runs() -> None:
    received: list[str] = []
    guard.tell(received.append)
    try:
        with guarded("phase CHECKED"):
            assert received == ["phase CHECKED"]
    finally:
        guard.tell(None)
    assert received == ["phase CHECKED", ""]


@pytest.mark.parametrize("code", ["raise SystemExit(1)", "raise KeyboardInterrupt", "raise RuntimeError('\\x1b[31m')"])
def test_a_package_that_ends_its_process_at_import_is_a_failed_one(install: Install, code, monkeypatch) -> None:
    monkeypatch.setattr(signal, "getsignal", lambda _: signal.SIG_IGN)
    install(registry.PHASES, "BAD", "apply", code)
    assert list(registry.loaded(registry.PHASES).failed) == ["BAD"]
    assert registry.why_missing(registry.PHASES, "BAD").isprintable()
    assert registry.why_missing(registry.PHASES, "NONE") == "no installed package has it"
