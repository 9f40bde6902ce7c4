"""The demos: they check themselves against the simulator. `make wheel` performs `rtc demo grasp`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from examples.swapout import swapout
from tests.campaigns import faults


def test_an_arm_is_judged_over_several_samples_however_quickly_the_broker_is_back():
    """Telemetry comes every 20 ms; a broker may be back after 5."""
    samples = [(0.02 * n, 0.3) for n in range(100)]
    assert faults.judged_speed_rad_s(samples, struck_s=1.001, back_s=0.005) == 0.3
    assert faults.judged_speed_rad_s([*samples, (1.1, 0.01)], struck_s=1.001, back_s=0.005) == 0.01
    assert faults.judged_speed_rad_s([], struck_s=1.001, back_s=0.005) == 0.0


def test_rtc_demo_becomes_the_program_of_the_example(tmp_path: Path):
    program = "from rtc.apps.cli.entry import main; main()"
    words = [sys.executable, "-c", program, "demo", "swapout", "--part", "insertoin"]
    refused = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2
    assert "insertion" in refused.stderr


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.timeout(400)
def test_the_insertion_of_the_swap_out_is_halted_taken_up_again_and_ends_with_a_closed_door(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    few = swapout.PARTS["insertion"]._replace(frame_s=3600.0)  # drawing all frames takes half a minute of a core
    monkeypatch.setitem(swapout.PARTS, "insertion", few)
    monkeypatch.setattr(swapout, "PICTURES", {"C28": swapout.PICTURES["C28"]})
    with Console(record=True, width=200) as console:
        passed = swapout.run(console, "max", tmp_path, part="insertion")
    assert passed, console.export_text()[-3000:]
    assert {file.name for file in tmp_path.iterdir()} >= {"insertion.gif", "5-inserted.png"}
