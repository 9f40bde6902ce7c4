"""Context manager that runs a temporary cluster in its own directory and always removes it.

The process `keeper` starts and ends the cluster, so that none is left behind by a program that is killed.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from rtc.protocol.outcomes import ClusterError
from rtc.runtime.settings import Mcm, Settings

DEFAULT = Settings(run_dir="")  # the defaults of `rtc up`


@contextmanager
def own_cluster(
    *,
    cell: str = "swapout",
    mcm: Mcm = "bullet",
    speed: str = "1",
    dim: int = 2,
    listen: str = "",
    least: int | None = None,
    most: int = DEFAULT.most_workers,
    more: str = "",
) -> Iterator[Path]:
    """The run directory of a new cluster. Raises ClusterError, with its last output, if it does not start.

    `least`, `most`: limits of the number of local workers of each kind; None = as `rtc up` has them.
    `more`: command line for more workers.
    The end of this process ends the cluster too, also by SIGKILL.
    """
    run_dir = Path(tempfile.mkdtemp(prefix="rtc-"))
    before = signal.signal(signal.SIGTERM, _interrupt)
    settings = Settings(
        run_dir=str(run_dir),
        cell=cell,
        mcm=mcm,
        speed=0.0 if speed == "max" else float(speed),
        dim=dim,
        listen=listen,
        least_workers=least,
        most_workers=most,
        more=more,
    )
    given = msgspec.json.encode(settings).decode()
    keeper = subprocess.Popen(
        [sys.executable, "-P", "-m", "rtc.apps.demos.keeper", str(run_dir), given],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert keeper.stdout is not None
    try:
        if problem := json.loads(keeper.stdout.readline() or '"the keeper of the cluster has ended"'):
            raise ClusterError(problem)
        yield run_dir
    finally:
        signal.signal(signal.SIGTERM, before)
        _, trouble = keeper.communicate()  # it has limits of its own, and ends the cluster when its input ends
    if trouble:
        raise ClusterError(trouble)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt
