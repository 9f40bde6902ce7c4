"""The cluster of a demo ends with the demo, however that ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.protocol.outcomes import ClusterError

DEMO = """
import signal, sys
from rtc.apps.demos.own_cluster import own_cluster
signal.signal(signal.SIGINT, signal.default_int_handler)  # a test in the background inherits that it is ignored
with own_cluster(mcm="kinematic", dim=2, most=1) as run_dir:
    print(run_dir, flush=True)
    sys.stdin.read()
"""
LIMIT_S = 120.0  # on a busy machine


def of_cluster(run_dir: str) -> list[str]:
    """Command lines of the processes that name this run directory."""
    lines = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = file.read_bytes().decode(errors="replace").replace("\0", " ")
        except OSError:  # it has ended meanwhile
            continue
        lines += [words] if run_dir in words else []
    return lines


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.timeout(400)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])  # SIGHUP ends it as SIGKILL does
def test_a_demo_that_is_killed_takes_its_cluster_with_it(number: signal.Signals) -> None:
    demo = subprocess.Popen(
        [sys.executable, "-P", "-c", DEMO], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert demo.stdout is not None
    run_dir = demo.stdout.readline().strip()
    assert run_dir
    assert of_cluster(run_dir)

    os.kill(demo.pid, number)
    demo.wait(LIMIT_S)

    until_s = time.monotonic() + LIMIT_S
    while (left := of_cluster(run_dir)) or Path(run_dir).exists():
        assert time.monotonic() < until_s, left
        time.sleep(0.1)
    demo.communicate()


@pytest.mark.slow
@pytest.mark.untimed
def test_a_cluster_that_does_not_start_says_why() -> None:
    with pytest.raises(ClusterError, match="nowhere"), own_cluster(cell="nowhere"):
        raise AssertionError("it has started")
