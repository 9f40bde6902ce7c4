"""A limit for the time of code of a package in the main thread: what goes on longer is cut off by an exception.

    time_limit.install()       # from now on, `rtc.plugins.guard` has every block within its limit

    with within(0.01):
        ...                    # raises TookTooLong

Two kinds of time count: of the processor, and without it where the code waits for something, seen twice in succession.
A thread that a busy machine does not schedule, or that was frozen, has neither: load alone cuts nothing off. The
exception comes between two bytecodes. A call of a library that does not return, or code that catches every exception,
ends its process at the second limit: SIGABRT, with the stack in the log.

The timers are those of the kernel with signals of their own. So `signal.alarm` and `signal.setitimer` stay free.
Without a main thread (a worker in a program of others) there is no limit here; that of its job remains.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rtc.plugins import guard
from rtc.plugins.guard import TookTooLong

END_FACTOR, END_S = 2.0, 0.05  # the second limit, of processor time: this factor times the first, and this more
AGAIN = 0.1  # pause before the next exception, if the first one has not ended it: this factor times the limit
PROGRESS_S = 0.001  # least processor time that counts as work
_SIGNAL = signal.SIGRTMIN + 5
#: files of the code between a caller and that of a package
_NOT_CUT = (__file__, guard.__file__, contextlib.__file__)


class _Spec(ctypes.Structure):
    """struct itimerspec."""

    _fields_ = [("interval", ctypes.c_long * 2), ("value", ctypes.c_long * 2)]


class _Event(ctypes.Structure):
    """struct sigevent, which has 64 bytes."""

    _fields_ = [
        ("value", ctypes.c_void_p),
        ("signo", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("thread", ctypes.c_int),
        ("rest", ctypes.c_char * 44),
    ]


SIGEV_THREAD_ID = 4
_libc = ctypes.CDLL(None, use_errno=True)


class _Timer:
    """A timer of the kernel that sends `number` to the thread that has made it."""

    def __init__(self, clock: int, number: int) -> None:
        event = _Event(signo=number, notify=SIGEV_THREAD_ID, thread=threading.get_native_id())
        self._id, self._spec = ctypes.c_void_p(), _Spec()
        if _libc.timer_create(clock, ctypes.byref(event), ctypes.byref(self._id)):
            raise OSError(ctypes.get_errno(), "timer_create")
        self._set, self._reference = _libc.timer_settime, ctypes.byref(self._spec)

    def set(self, left_s: float) -> None:
        """0: not at all."""
        value = self._spec.value
        value[0] = int(left_s)
        value[1] = int(left_s % 1.0 * 1e9)
        self._set(self._id, 0, self._reference, None)


class _Running:
    """The block under a limit, of which there is one: the outermost."""

    pid = 0  # of the process that has made the timers: a fork has none
    first: _Timer
    second: _Timer
    limit_s = 0.0  # 0: no block
    began_s = 0.0  # processor time
    seen_s = 0.0  # the same at the latest look
    waits = 0  # voluntary changes to another thread, then
    waited = False  # since the look before that


def install() -> None:
    """In this process, and in those that it forks."""
    guard.limit_by(within)


@contextmanager
def within(limit_s: float) -> Iterator[None]:
    """Raises TookTooLong. A block within another one has the limit of that."""
    if _Running.limit_s or threading.current_thread() is not threading.main_thread():
        yield
        return
    if _Running.pid != os.getpid():
        _prepare()
    _Running.began_s = _Running.seen_s = time.thread_time()
    _Running.waits, _Running.waited = _waits(), False
    _Running.limit_s = limit_s
    _Running.second.set(END_FACTOR * limit_s + END_S)
    _Running.first.set(limit_s)
    try:
        yield
    finally:
        _Running.limit_s = 0.0  # first: from here on nothing is cut off
        _Running.first.set(0.0)
        _Running.second.set(0.0)


def _prepare() -> None:
    signal.signal(_SIGNAL, _expired)
    _Running.first = _Timer(time.CLOCK_MONOTONIC, _SIGNAL)
    _Running.second = _Timer(time.CLOCK_THREAD_CPUTIME_ID, signal.SIGABRT)
    _Running.pid = os.getpid()


def _waits() -> int:
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw


def _expired(_: int, frame: FrameType | None) -> None:
    limit_s = _Running.limit_s
    if not limit_s:
        return  # the block has ended meanwhile
    now_s, waits = time.thread_time(), _waits()
    worked_s = now_s - _Running.began_s
    waits_now = now_s - _Running.seen_s < PROGRESS_S and waits > _Running.waits
    over = worked_s >= limit_s or (waits_now and _Running.waited)
    _Running.seen_s, _Running.waits, _Running.waited = now_s, waits, waits_now
    soon_s = AGAIN * limit_s
    _Running.first.set(soon_s if over or waits_now else max(limit_s - worked_s, soon_s))
    if over and frame is not None and frame.f_code.co_filename not in _NOT_CUT:
        raise TookTooLong
