"""One cluster for all tests that watch one, recorded from its start; the helpers to wait for what it publishes."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest

RTC = [sys.executable, "-P", "-m", "rtc.apps.cli.main"]
LIMIT_S = 60.0


class Watched(NamedTuple):
    run_dir: Path
    recordings: Path  # directory of the recordings of `rtc up --record`


def rtc(*words: object, cwd: Path | None = None, limit_s: float = 90.0) -> subprocess.CompletedProcess[str]:
    command = [*RTC, *map(str, words)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=limit_s, check=True)


def until(condition: Callable[[], object]) -> None:
    """Wait until a condition of another process holds."""
    limit_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < limit_s, condition
        time.sleep(0.02)


@pytest.fixture(scope="package")  # not "session": it would run beside all later tests
def watched(tmp_path_factory) -> Iterator[Watched]:
    recordings = tmp_path_factory.mktemp("recordings")
    with TemporaryDirectory(prefix="rtc-") as run_dir:  # a short path: sockets are in it
        try:
            rtc("up", "-d", "--mcm", "kinematic", "--speed", "max", "--record", "--run-dir", run_dir, cwd=recordings)
            yield Watched(Path(run_dir), recordings)
        finally:
            rtc("down", "--run-dir", run_dir)
