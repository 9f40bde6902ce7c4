"""Handover from the supervisor to its processes (settings, key, token), and the lock that admits one process per name.

The supervisor keeps these data in an anonymous file (memfd), whose descriptor every process inherits (`--handed FD`).
So no process depends on files of the run directory, which a user may delete. Some bytes of that file belong to one role
and survive its restarts, for example the number of the last batch in the journal.

A process that was started by hand has no such file: it reads the run directory, and ends if a cluster runs there.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import struct
import time
from collections.abc import Iterable
from pathlib import Path

import msgspec

from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import Settings

LEASE_KEY = "lease.key"  # in the run directory; see rtc.world.lease
OPTION = "--handed"
MEMORY_BYTES = 4096  # size of the roles' memory, in front of the body
MOTIONS_AT = 128  # offset of the names of the arms in motion, each ended by a line feed, all by a zero byte
#: role -> offset and format of its memory. broker: journal life, last batch, accepted commands
MEMORY: dict[str, tuple[int, struct.Struct]] = {
    "broker": (0, struct.Struct("<8sQQ")),
    "world": (64, struct.Struct("<8sQ")),
}
#: Time that broker and MCM need to stop arms and send outcomes after their supervisor was killed.
HOLD_S = 3.0  # at full speed


class _Body(msgspec.Struct, frozen=True):
    settings: Settings
    lease_key: bytes
    token: str


class Handover:
    """Settings, lease key, token (empty: started by hand), and the memory of each role."""

    def __init__(self, settings: Settings, lease_key: bytes = b"", token: str = "", fd: int = -1) -> None:
        self.settings, self.lease_key, self.token, self.fd = settings, lease_key, token, fd
        self._lock = -1

    @staticmethod
    def make(settings: Settings, lease_key: bytes, token: str) -> Handover:
        """Make the file, in the supervisor. The children inherit its `fd`."""
        fd = os.memfd_create("rtc-handed", os.MFD_CLOEXEC)
        os.pwrite(fd, msgspec.msgpack.encode(_Body(settings, lease_key, token)), MEMORY_BYTES)
        return Handover(settings, lease_key, token, fd)

    @staticmethod
    def read(fd: int) -> Handover:
        """Read the file, in a child."""
        body = msgspec.msgpack.decode(os.pread(fd, os.fstat(fd).st_size - MEMORY_BYTES, MEMORY_BYTES), type=_Body)
        return Handover(body.settings, body.lease_key, body.token, fd)

    def protects(self, name: str) -> bool:
        """Whether the ZeroMQ identity of this name contains the token, so that it cannot be guessed."""
        return name == "supervisor" or any(one.name == name and one.module for one in self.settings.subsystems)

    def identity(self, name: str) -> str:
        """ZeroMQ identity of the process `name` at the broker."""
        return f"{name}@{self.token}" if self.token and self.protects(name) else name

    def save_counters(self, role: str, *values: bytes | int) -> None:
        """Keep these values for the next process of this role. A process started by hand keeps nothing."""
        if self.fd >= 0:
            at, form = MEMORY[role]
            os.pwrite(self.fd, form.pack(*values), at)

    def remembered(self, role: str) -> tuple[bytes, int, int] | None:
        """The values that an earlier process kept, missing numbers as 0; None for the first process."""
        if self.fd < 0:
            return None
        at, form = MEMORY[role]
        life, *numbers = form.unpack(os.pread(self.fd, form.size, at))
        first, second = [*numbers, 0][:2]
        return (life.rstrip(b"\0"), first, second) if life.rstrip(b"\0") else None

    def world_version(self) -> int | None:
        """Version of the world database on disk, at the cost of a system call; None for a process started by hand.

        It is kept before a commit is acknowledged, and never decreases within a run."""
        kept = self.remembered("world")
        return kept[1] if kept else None

    def state_motions(self, arms: Iterable[str]) -> None:
        """Tell the world database which arms are in motion. No reader knows it if the process was started by hand.

        Raises ValueError if the names do not fit, with some 200 arms."""
        names = b"".join(arm.encode() + b"\n" for arm in arms) + b"\0"
        if len(names) > MEMORY_BYTES - MOTIONS_AT:
            raise ValueError(f"the names of the arms in motion need {len(names)} bytes")
        if self.fd >= 0:
            os.pwrite(self.fd, names, MOTIONS_AT)

    def motions(self) -> list[str]:
        """The arms in motion, as the broker last stated them."""
        if self.fd < 0:
            return []
        names, _, _ = os.pread(self.fd, MEMORY_BYTES - MOTIONS_AT, MOTIONS_AT).partition(b"\0")
        return names.decode(errors="replace").splitlines()

    def lock(self, name: str) -> None:
        """Lock `name` in the run directory until this process ends. Raises SystemExit if another process has it."""
        path = self.settings.path / f"{name}.lock"
        try:
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            _lock_within(self._lock, HOLD_S * self.settings.timeout_scale if self.fd >= 0 else 0.0)
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


def load(run_dir: Path, fd: int) -> Handover:
    """The handed data; for a process started by hand, those of the run directory. Raises SystemExit."""
    if fd >= 0:
        return Handover.read(fd)
    try:
        settings = Settings.load(run_dir)
    except FileNotFoundError:
        raise SystemExit(f"{run_dir} has no settings.json: start a cluster with: rtc up") from None
    except (OSError, msgspec.DecodeError) as error:
        raise SystemExit(f"{run_dir}/settings.json cannot be read: {error}") from None
    key = b""
    with contextlib.suppress(OSError):
        key = (run_dir / LEASE_KEY).read_bytes()
    return Handover(settings, key)


def claim_role(name: str, run_dir: Path, fd: int) -> Handover:
    """Load the handed data and lock `name`. Raises SystemExit if another process has it, before a socket opens."""
    handed = load(run_dir, fd)
    if fd < 0 and supervised(run_dir, by_hand=False):
        raise SystemExit(f"a cluster runs in {run_dir}, and has its own {name}; a second one is not started")
    handed.lock(name)
    return handed
