"""The guard round code of installed packages: its caller gets a value, or a `PluginError` that names it.

    with registry.guarded(registry.TIMING, name):
        timed = converted(time(arm, path))        # the call, the conversion and the check of what it returns

All of that belongs into one block: an odd value may fail only when it is converted. SystemExit and other exceptions
that would end the process are failures like any other. What takes longer than its limit is cut off
(`rtc.runtime.time_limit`), and refused without a call for the rest of the job. A process that the package has forked
ends where it would leave the block: it would go on as a second copy of its parent, with the same sockets. If it stays
inside, the kernel ends it with its parent.
"""

from __future__ import annotations

import ctypes
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import ClassVar

from rtc.protocol.outcomes import Refused, RtcError

PR_SET_PDEATHSIG = 1
LIMIT_S = 5.0  # for one call, unless its group has another limit
WORDS_OF_ERROR = 200  # characters of an exception of a package that are passed on


class PluginError(RtcError):
    """Code of a package has failed, or has returned what it must not."""

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"the {name} of an installed package {problem}")
        self.problem = problem


class TookTooLong(BaseException):
    """A block has gone on beyond its limit. Code of a package may catch every Exception of its own."""


def _unwatched(_: str) -> None:
    """No one watches this process."""


def _unlimited(_: float) -> AbstractContextManager[None]:
    return nullcontext()


class _Guard:
    """Of this process."""

    witness: Callable[[str], None] = staticmethod(_unwatched)  # see `tell`
    limit: Callable[[float], AbstractContextManager[None]] = staticmethod(_unlimited)  # see `limit_by`
    depth = 0  # blocks that it is in
    cut_off: ClassVar[set[str]] = set()  # names of what was cut off in this job


def tell(witness: Callable[[str], None] | None) -> None:
    """From now on `witness` is called with the name of each entry point before its code runs, and with "" after it."""
    _Guard.witness = staticmethod(witness or _unwatched)


def limit_by(within: Callable[[float], AbstractContextManager[None]]) -> None:
    """From now on each block runs within `within(seconds)`, which raises TookTooLong."""
    _Guard.limit = staticmethod(within)


def begin_anew() -> None:
    """What was cut off before may be called again."""
    _Guard.cut_off.clear()


@contextmanager
def guarded(name: str, file: str = "", limit_s: float = LIMIT_S) -> Iterator[None]:
    """Raises PluginError for any exception of the block but Refused.

    `name`: of the code, "phase CHECKED". `file`: where it is. `limit_s`: for the block."""
    if name in _Guard.cut_off:
        raise PluginError(name, f"is not called again in this job, where it was cut off{_in_file(file)}")
    process = os.getpid()
    _Guard.witness(f"{name}{_in_file(file)}")
    _Guard.depth += 1
    try:
        with _Guard.limit(limit_s):
            yield
    except (Refused, PluginError):
        raise
    except TookTooLong as error:
        _Guard.cut_off.add(name)
        raise PluginError(name, f"was cut off after {limit_s:g} s{_in_file(file, error)}") from None
    except BaseException as error:
        if _is_of_user(error):
            raise
        raise PluginError(name, f"has failed: {in_words(error)}{_in_file(file, error)}") from None
    finally:
        if os.getpid() != process:
            os._exit(0)
        _Guard.depth -= 1
        _Guard.witness("")


def in_words(error: BaseException) -> str:
    """Kind and text of an exception of others: one printable line of bounded length."""
    kind = _printable(lambda: type(error).__name__) or "an exception without a name"
    text = _printable(lambda: str(error))
    return f"{kind}: {text}" if text else kind


def _printable(text: Callable[[], str]) -> str:
    """Its printable characters, at most WORDS_OF_ERROR; '' if it fails: it is code of others, too."""
    try:
        found = str.__str__(text())[:WORDS_OF_ERROR]
        return "".join(character if character.isprintable() else " " for character in found)
    except BaseException as error:
        if _is_of_user(error):
            raise
        return ""


def _in_file(file: str, error: BaseException | None = None) -> str:
    """ " (FILE, line N)": where in this file the exception came from."""
    line, trace = 0, error.__traceback__ if error is not None else None
    while trace is not None:
        line = trace.tb_lineno if trace.tb_frame.f_code.co_filename == file else line
        trace = trace.tb_next
    return (f" ({file}, line {line})" if line else f" ({file})") if file else ""


def _is_of_user(error: BaseException) -> bool:
    """Whether it is the Ctrl-C of a person. In a process of a cluster a signal raises nothing."""
    return isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _in_child() -> None:
    """In a process that was just forked: the kernel kills it with its parent, if code of a package has forked it."""
    if _Guard.depth:
        _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


_libc = ctypes.CDLL(None)
os.register_at_fork(after_in_child=_in_child)
