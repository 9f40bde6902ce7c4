"""Context manager that runs a temporary cluster in its own directory and always removes it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rtc.protocol.outcomes import ClusterError

READY_S, DOWN_S = 700.0, 300.0  # longer than the limits of `rtc up` and `rtc down` themselves, on a busy machine


@contextmanager
def own_cluster(
    *,
    cell: str = "swapout",
    mcm: str = "bullet",
    speed: str = "1",
    dim: int = 2,
    listen: str = "",
    least: int | None = None,
    most: int | None = None,
    more: str = "",
) -> Iterator[Path]:
    """The run directory of a new cluster. Raises ClusterError, with its last output, if it does not start.

    `least`, `most`: limits of the number of local workers of each kind; None = as `rtc up` has them.
    `more`: command line for more workers.
    SIGTERM to this process ends the cluster too.
    """
    run_dir = Path(tempfile.mkdtemp(prefix="rtc-"))
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        options = ["--cell", cell, "--mcm", mcm, "--speed", speed, "--dim", str(dim), "--listen", listen]
        if least is not None:
            options += ["--least", str(least)]
        if most is not None:
            options += ["--most", str(most)]
        if more:
            options += ["--more", more]
        _deploy("up", run_dir, READY_S, "-d", *options)
        yield run_dir
    finally:
        signal.signal(signal.SIGTERM, before)
        try:
            _deploy("down", run_dir, DOWN_S)
        finally:
            shutil.rmtree(run_dir, ignore_errors=True)


def _deploy(what: str, run_dir: Path, limit_s: float, *options: str) -> None:
    command = [sys.executable, "-P", "-m", "rtc.apps.cli.entry", what, "--run-dir", str(run_dir), *options]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, start_new_session=True)
    except subprocess.TimeoutExpired:
        raise ClusterError(f"the cluster did not answer `{what}` within {limit_s:.0f} s") from None
    if done.returncode != 0:
        raise ClusterError(f"cluster {what} failed: {(done.stdout + done.stderr).strip()[-2000:]}")


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
