"""What the supervisor hands to the processes of its cluster, and the lock that makes each of them the only one.

The supervisor keeps settings, lease key and a token in a file without a name (a memfd), which every process inherits by
its number (`--handed FD`). Nothing that a process needs for its start lies in the run directory, where it may be
deleted. A few bytes of that file are one role's own memory across its lives, such as the last turn in the journal.

A process that is started by hand has no such file: it reads the run directory, and gives way to a cluster that runs.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import struct
import time
from pathlib import Path

import msgspec

from rtc.settings import Settings
from rtc.silence import supervised

LEASE_KEY = "lease.key"  # in the run directory; rtc.world.lease says what it is for
OPTION = "--handed"
MEMORY_BYTES = 4096  # before the body
#: role -> where its memory lies, and how: life and last turn of the journal, commands accepted; version of the world
MEMORY: dict[str, tuple[int, struct.Struct]] = {
    "broker": (0, struct.Struct("<8sQQ")),
    "world": (64, struct.Struct("<8sQ")),
}
#: For broker and MCM of a cluster whose supervisor was killed a moment ago: they stop the arms, and send the outcomes.
HOLD_S = 3.0  # at full speed; longer than both take then
TOKEN_BEARERS = ("MCM", "supervisor")  # names whose ZeroMQ identity nobody else can guess


class _Body(msgspec.Struct, frozen=True):
    settings: Settings
    lease_key: bytes
    token: str


class Handed:
    """Settings, lease key, token (empty: started by hand), and the memory of each role."""

    def __init__(self, settings: Settings, lease_key: bytes = b"", token: str = "", fd: int = -1) -> None:
        self.settings, self.lease_key, self.token, self.fd = settings, lease_key, token, fd
        self._lock = -1

    @staticmethod
    def make(settings: Settings, lease_key: bytes, token: str) -> Handed:
        """The supervisor's. Its `fd` is for the children."""
        fd = os.memfd_create("rtc-handed", os.MFD_CLOEXEC)
        os.pwrite(fd, msgspec.msgpack.encode(_Body(settings, lease_key, token)), MEMORY_BYTES)
        return Handed(settings, lease_key, token, fd)

    @staticmethod
    def read(fd: int) -> Handed:
        """A child's."""
        body = msgspec.msgpack.decode(os.pread(fd, os.fstat(fd).st_size - MEMORY_BYTES, MEMORY_BYTES), type=_Body)
        return Handed(body.settings, body.lease_key, body.token, fd)

    def identity(self, name: str) -> str:
        """What a process of this name is called on its line to the broker."""
        return f"{name}@{self.token}" if self.token and name in TOKEN_BEARERS else name

    def remember(self, role: str, *values: bytes | int) -> None:
        """Keep these for the next life of this role. A role that was started by hand keeps nothing."""
        if self.fd >= 0:
            at, form = MEMORY[role]
            os.pwrite(self.fd, form.pack(*values), at)

    def remembered(self, role: str) -> tuple[bytes, int, int] | None:
        """What an earlier life kept, the missing numbers 0; None: this is the first life."""
        if self.fd < 0:
            return None
        at, form = MEMORY[role]
        life, *numbers = form.unpack(os.pread(self.fd, form.size, at))
        first, second = [*numbers, 0][:2]
        return (life.rstrip(b"\0"), first, second) if life.rstrip(b"\0") else None

    def hold(self, name: str) -> None:
        """Be the only process of this name in the run directory, until this process dies. Ends with a sentence."""
        path = self.settings.path / f"{name}.lock"
        try:
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            _lock_within(self._lock, HOLD_S * self.settings.patience if self.fd >= 0 else 0.0)
        except BlockingIOError:
            raise SystemExit(f"{self.settings.path} has its {name} already; a second one is not started") from None
        except OSError:  # a full disk, or the directory is gone: the supervisor looks after that
            if self.fd < 0:
                raise


def _lock_within(fd: int, limit_s: float) -> None:
    """Raises BlockingIOError."""
    end_s = time.monotonic() + limit_s
    while True:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= end_s:
                raise
            time.sleep(0.01)


def add_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(OPTION, type=int, default=-1, help=argparse.SUPPRESS)


def load(run_dir: Path, fd: int) -> Handed:
    """What was handed over; of a process started by hand, what lies in the run directory. Ends with a sentence."""
    if fd >= 0:
        return Handed.read(fd)
    try:
        settings = Settings.load(run_dir)
    except FileNotFoundError:
        raise SystemExit(f"{run_dir} has no settings.json: start a cluster with: rtc up") from None
    except (OSError, msgspec.DecodeError) as error:
        raise SystemExit(f"{run_dir}/settings.json cannot be read: {error}") from None
    key = b""
    with contextlib.suppress(OSError):
        key = (run_dir / LEASE_KEY).read_bytes()
    return Handed(settings, key)


def begin(name: str, run_dir: Path, fd: int) -> Handed:
    """Be the one process of this name in this run directory, or end with a sentence before any socket is touched."""
    handed = load(run_dir, fd)
    if fd < 0 and supervised(run_dir, by_hand=False):
        raise SystemExit(f"a cluster runs in {run_dir}, and has its own {name}; a second one is not started")
    handed.hold(name)
    return handed
