"""The user's command line that asks an engine for workers on other machines (`rtc up --more`).

It runs beside the supervisor, one run at a time, with a time limit. Only the command itself is ended at that limit.
Workers that it has started in the background keep running, and their output goes to the same log.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import string
import subprocess
from pathlib import Path

import msgspec

from deploy.child import begin, open_log
from rtc.protocol.messages import RequestWorkers, WorkerKind, WorkerRequest
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.process import now_s
from rtc.runtime.process_table import in_words
from rtc.runtime.settings import Settings

RUN_LIMIT_S = 30.0  # time limit of one run; then SIGTERM, and SIGKILL after END_LIMIT_S
END_LIMIT_S = 2.0
PLACES = ("kind", "count")
LINE = 160  # characters of the last line that are kept
TAIL_BYTES = 4096


def check_more(settings: Settings) -> None:
    """Check the command line. Raises ClusterError, with what would clear it, if it could have no effect."""
    if not settings.more:
        default = Settings(run_dir=settings.run_dir)
        if (settings.scale_out_max, settings.scale_out_timeout_s) != (
            default.scale_out_max,
            default.scale_out_timeout_s,
        ):
            raise ClusterError("--more-max and --more-wait have no effect without --more; give a command line, too")
        return
    words = _words(settings.more)
    if not settings.listen:
        raise ClusterError("--more asks for workers on other machines, which need --listen tcp://HOST:PORT to join")
    places = {place for word in words for place in _places(word)}
    if "kind" not in places:
        raise ClusterError("--more has no {kind}; write {kind} where the command needs the kind of worker to start")
    if shutil.which(words[0]) is None:
        raise ClusterError(f"--more: there is no command {words[0]!r:.80} here; give its full path, or install it")


def _words(line: str) -> list[str]:
    """The words of a command line, as a shell splits them; no shell is used. Raises ClusterError."""
    try:
        words = shlex.split(line)
    except ValueError as error:
        raise ClusterError(f"--more cannot be split into words: {error}") from None
    if not words:
        raise ClusterError("--more is empty; leave it out, or give a command line")
    return words


def _places(word: str) -> list[str]:
    """The names in braces. Raises ClusterError for an unknown one."""
    try:
        fields = [field for field in string.Formatter().parse(word) if field[1] is not None]
    except ValueError as error:
        raise ClusterError(f"--more, at {word!r:.80}: {error}; write {{{{ and }}}} for braces of the command") from None
    for _, name, form, conversion in fields:
        if name not in PLACES or form or conversion:
            raise ClusterError(
                f"--more, at {word!r:.80}: only {{kind}} and {{count}} are replaced; "
                "write {{ and }} for braces of the command"
            )
    return [str(name) for _, name, _, _ in fields]


class MoreCommand:
    """Runs of the command line. `exited_fd` becomes readable when a run ends; -1 while none is in progress."""

    def __init__(self, line: str, log: Path) -> None:
        self._words, self.log = _words(line), log
        self._asked: dict[WorkerKind, WorkerRequest] = {}
        self._run: WorkerRequest | None = None  # the run in progress
        self._popen: subprocess.Popen[bytes] | None = None
        self._end_at_s = 0.0
        self._log_from = 0  # size of the log at the start of the run
        self._overdue = False
        self.exited_fd = -1

    @property
    def pid(self) -> int:
        """Process id of the run in progress; 0 = none."""
        return self._popen.pid if self._popen else 0

    def asked(self) -> list[WorkerRequest]:
        """The latest run for each kind."""
        return list(self._asked.values())

    def start(self, order: RequestWorkers) -> str:
        """Start a run, unless one is in progress. Returns words about it for people."""
        if self._popen is not None:
            return ""
        words = [word.format(kind=order.kind.value, count=order.count) for word in self._words]
        self._run = WorkerRequest(
            kind=order.kind, count=order.count, registered_before=order.registered_before, at_s=now_s(), running=True
        )
        self._asked[order.kind] = self._run
        me = os.getpid()
        try:
            with open_log(self.log) as log:
                self._log_from = log.seek(0, os.SEEK_END)
                self._popen = subprocess.Popen(
                    words,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                    preexec_fn=lambda: begin(me),
                )
            self.exited_fd = os.pidfd_open(self._popen.pid)
        except OSError as error:
            if self._popen is not None:
                self._popen.kill()
                self._popen.wait()
                self._popen = None
            return self._finish(f"cannot be started: {error.strerror}")
        self._end_at_s, self._overdue = now_s() + RUN_LIMIT_S, False
        return f"asking for {in_number(order.count, order.kind)}: {shlex.join(words)}"

    def end_overdue(self, now: float) -> None:
        """End a run that exceeds its time limit. To be called about once a second."""
        if self._popen is not None and now >= self._end_at_s:
            self.end(kill=self._overdue)
            self._overdue, self._end_at_s = True, now + END_LIMIT_S

    def end(self, kill: bool = False) -> None:
        """Signal the run in progress, not what it has started."""
        if self._popen is not None:
            signal.pidfd_send_signal(self.exited_fd, signal.SIGKILL if kill else signal.SIGTERM)

    def reap(self) -> str:
        """To be called when `exited_fd` is readable. Returns words about a failure for people; empty = success."""
        assert self._popen is not None
        status = self._popen.wait()
        os.close(self.exited_fd)
        self._popen, self.exited_fd = None, -1
        if self._overdue:
            return self._finish(f"was ended after its time limit of {RUN_LIMIT_S:g} s")
        return self._finish("" if status == 0 else in_words(status))

    def _finish(self, failed: str) -> str:
        assert self._run is not None
        line = self._last_line()
        ended = msgspec.structs.replace(self._run, running=False, failed=failed, output=line)
        self._asked[ended.kind], self._run = ended, None
        return f"the command for more workers {failed}{f': {line}' if line else ''}" if failed else ""

    def _last_line(self) -> str:
        """The last line that this run has written; empty if none."""
        try:
            with open(self.log, "rb") as log:
                size = log.seek(0, os.SEEK_END)
                log.seek(max(self._log_from if self._log_from <= size else 0, size - TAIL_BYTES))
                lines = log.read().decode(errors="replace").split("\n")
        except OSError:
            return ""
        return next((line.strip()[:LINE] for line in reversed(lines) if line.strip()), "")


def in_number(count: int, kind: WorkerKind) -> str:
    """1 binder, 4 binders"""
    return f"{count} {kind.value}{'s' if count != 1 else ''}"
