"""The main job, as `make demo` runs it: it checks itself against the simulator."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_grasp_demo_passes_all_its_checks_and_leaves_its_pictures(tmp_path):
    command = [sys.executable, "-m", "rtc.cli.main", "demo", "grasp", "--speed", "max"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=380)
    failed = [line for line in done.stdout.splitlines() if "FAIL" in line]
    assert (done.returncode, failed) == (0, []), done.stdout[-3000:]
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
