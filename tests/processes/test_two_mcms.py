"""Two subsystems of arms in one cell, each a process: they work, stop, fail and come back independently."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

FIRST, SECOND = "MCM", "MCM-2"
CELL = f"""
extends: swapout
name: two-controllers
cameras: []
tags: []
subsystems:
  - {{name: {SECOND}, module: sim_mcm, estop: true, performers: [LEFT-ARM]}}
"""
AWAY = "MOVE {} BY 12 CM ALONG UP MAINTAIN SPEED 3 CM/S"  # four seconds
LIMIT_S = 60.0


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    cell = tmp_path_factory.mktemp("cell") / "cell.yaml"
    cell.write_text(CELL)
    with own_cluster(cell=str(cell), mcm="kinematic") as run_dir:
        yield run_dir


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as rtc:
        yield rtc
        assert rtc.halt().confirmed
        for arm in ("LEFT-ARM", "RIGHT-ARM"):
            assert rtc.run(f"STOW {arm}", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def until_moving(rtc: Client, *arms: str) -> None:
    """Wait until these arms are on their way."""
    moving: dict[str, bool] = {}
    for sample in rtc.telemetry(silence_s=LIMIT_S):
        moving |= {name: max(map(abs, arm.velocities)) > 0.01 for name, arm in sample.arms.items()}
        if all(moving.get(arm) for arm in arms):
            return
    raise AssertionError(f"{arms} do not move")


def test_each_has_its_own_arm(run_dir: Path, rtc: Client) -> None:
    assert {one.name for one in Settings.load(run_dir).subsystems if one.estop} == {FIRST, SECOND}
    owners = {row.name: set(row.performers) for row in rtc.status().subsystems}
    assert owners[FIRST] == {"RIGHT-ARM"}
    assert owners[SECOND] == {"LEFT-ARM"}
    assert rtc.run("STOW LEFT-ARM", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_a_halt_of_one_arm_leaves_the_other_moving(rtc: Client) -> None:
    right, left = (rtc.submit(AWAY.format(arm)) for arm in ("RIGHT-ARM", "LEFT-ARM"))
    until_moving(rtc, "RIGHT-ARM", "LEFT-ARM")

    halted = rtc.halt("LEFT-ARM")

    assert halted.confirmed
    assert halted.moving == ["LEFT-ARM"]
    assert left.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED
    assert right.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_a_halt_of_all_is_confirmed_by_both(rtc: Client) -> None:
    submitted = [rtc.submit(AWAY.format(arm)) for arm in ("RIGHT-ARM", "LEFT-ARM")]
    until_moving(rtc, "RIGHT-ARM", "LEFT-ARM")

    halted = rtc.halt()

    assert halted.confirmed
    assert halted.moving == ["LEFT-ARM", "RIGHT-ARM"]
    assert {sub.name for sub in halted.subsystems} >= {FIRST, SECOND}
    assert {one.wait(LIMIT_S).outcome.kind for one in submitted} == {OutcomeKind.HALTED}


@pytest.mark.parametrize(
    ("killed", "arm", "other"), [(SECOND, "LEFT-ARM", "RIGHT-ARM"), (FIRST, "RIGHT-ARM", "LEFT-ARM")]
)
def test_one_that_dies_does_not_stop_the_other_and_comes_back(
    run_dir: Path, rtc: Client, killed: str, arm: str, other: str
) -> None:
    lost, kept = rtc.submit(AWAY.format(arm)), rtc.submit(AWAY.format(other))
    until_moving(rtc, arm, other)

    os.kill(processes(run_dir)[killed].pid, signal.SIGKILL)

    assert lost.wait(LIMIT_S).outcome.kind is OutcomeKind.LOST_SUBSYSTEM
    assert kept.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
    # the fixture stows both arms again


def test_both_arms_in_one_motion_are_refused(rtc: Client) -> None:
    outcome = rtc.run("MOVE BOTH-ARMS BY 5 CM ALONG UP", timeout_s=LIMIT_S).outcome

    assert outcome.kind is OutcomeKind.REFUSED


def test_a_subsystem_of_arms_obeys_a_halt_without_the_broker(run_dir: Path, rtc: Client) -> None:
    """Each has a socket for halts of its own."""
    settings = Settings.load(run_dir)
    addresses = settings.addresses("estop")
    assert len(set(addresses.values())) == 2
    with zmq.Context() as context:
        for address in addresses.values():
            with context.socket(zmq.DEALER) as socket:
                socket.setsockopt(zmq.LINGER, 0)
                socket.setsockopt(zmq.IMMEDIATE, 1)
                socket.connect(address)
                assert socket.poll(5000, zmq.POLLOUT)


def test_the_command_line_halts_both(run_dir: Path, rtc: Client) -> None:
    for arm in ("RIGHT-ARM", "LEFT-ARM"):
        rtc.submit(AWAY.format(arm))
    until_moving(rtc, "RIGHT-ARM", "LEFT-ARM")

    done = subprocess.run(
        [sys.executable, "-P", "-m", "rtc.apps.cli.entry", "halt", "--run-dir", str(run_dir)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )

    assert done.returncode == 0, done.stdout + done.stderr
    assert "RIGHT-ARM" in done.stdout
    assert "LEFT-ARM" in done.stdout
