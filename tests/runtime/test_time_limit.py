"""The limit for the time of code of packages: what hangs is cut off or ends its process; what is only slow is not."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import time
from collections.abc import Callable

import pytest

from rtc.plugins.guard import TookTooLong
from rtc.runtime.time_limit import within

LIMIT_S = 0.03


def spin() -> None:
    while True:
        work(0.001)


def work(for_s: float) -> None:
    end_s = time.thread_time() + for_s
    while time.thread_time() < end_s:
        pass


def sleep() -> None:
    time.sleep(600.0)


def doze() -> None:
    while True:
        time.sleep(0.002)


def catch() -> None:
    while True:
        with contextlib.suppress(Exception):
            spin()


@pytest.mark.parametrize("hang", [spin, sleep, doze, catch])
def test_what_hangs_is_cut_off(hang: Callable[[], None]) -> None:
    before_s = time.thread_time()
    with pytest.raises(TookTooLong), within(LIMIT_S):
        hang()
    assert time.thread_time() - before_s < 3 * LIMIT_S


def test_the_limit_is_that_of_the_outermost_block_and_ends_with_it() -> None:
    with pytest.raises(TookTooLong), within(LIMIT_S), within(60.0):
        spin()
    with within(LIMIT_S):
        pass
    work(2 * LIMIT_S)


def test_a_call_of_a_library_that_does_not_return_ends_its_process() -> None:
    child = os.fork()
    if child == 0:
        faulthandler.disable()
        with within(LIMIT_S):
            sum(range(10**12))
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGABRT


def test_a_process_that_was_frozen_goes_on() -> None:
    """Given code that needs half of its limit, when its process is frozen for longer, then it is not cut off."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        with within(LIMIT_S):
            os.write(write, b"!")
            work(LIMIT_S / 2)
        os._exit(7)
    os.read(read, 1)
    os.kill(child, signal.SIGSTOP)
    os.waitpid(child, os.WUNTRACED)
    signal.sigtimedwait([], 5 * LIMIT_S)
    os.kill(child, signal.SIGCONT)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    os.close(read)
    os.close(write)
