"""The program of docs/own-subsystem.md works as the page shows it: it performs a sentence and obeys a halt."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

PAGE = Path(__file__).parents[2] / "docs" / "own-subsystem.md"
LIMIT_S = 60.0
POSITION = (0.782, -0.801, 0.601)
SENTENCE = "LOCATE MACS-NEW VIA CAMERA-1"


def block(language: str) -> str:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)[0]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("own")
    (folder / "cell.yaml").write_text(block("yaml"))
    (folder / "tracker.py").write_text(block("python"))
    with own_cluster(cell=str(folder / "cell.yaml"), mcm="kinematic") as run_dir:
        words = [sys.executable, str(folder / "tracker.py"), str(run_dir), *map(str, POSITION)]
        with subprocess.Popen(words) as tracker:
            yield run_dir
            tracker.send_signal(signal.SIGTERM)


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as rtc:
        for _ in range(500):  # it has just been started
            if "TRACKER" in {row.name for row in rtc.status().subsystems}:
                break
        yield rtc


def test_it_performs_a_sentence(rtc: Client) -> None:
    outcome = rtc.run(SENTENCE, timeout_s=LIMIT_S).outcome

    assert outcome.kind is OutcomeKind.SUCCEEDED, outcome
    (fact,) = rtc.world.view(keys=["MACS-NEW.frame"]).facts
    assert fact.value[:3] == pytest.approx(POSITION, abs=1e-3)


def test_a_halt_reaches_it(rtc: Client) -> None:
    submitted = rtc.submit(SENTENCE)
    for _ in range(2000):
        if any(row.owner for row in rtc.status().resources if row.name == "CAMERA-1"):
            break

    assert rtc.halt("CAMERA-1").confirmed
    assert submitted.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED
