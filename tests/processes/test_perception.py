"""S&P in a cluster: what cameras find by pixels, halts, its death. Real processes, drawn pictures, exact arms."""

from __future__ import annotations

import math
import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from benchmarks.track import at, turning
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.handle import CommandHandle
from rtc.protocol import messages as m
from rtc.protocol.faults import BlindCamera, Drifting
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.spatial import geometry
from tests.campaigns.chaos import Chaos

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LIMIT_S = 90.0
MODULE = "MACS-OLD"


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="kinematic", dim=2) as path:
        yield path


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as client:
        yield client


def follow(rtc: Client, until: int) -> CommandHandle:
    """A TRACK without an end, once it has sent some poses."""
    seen: list[m.ProgressNote] = []

    def note(one: m.ProgressNote) -> None:
        if one.measured is not None and one.measured.sighting is not None:
            seen.append(one)

    command = rtc.submit("TRACK SATELLITE VIA CAMERA-3 REPORT POSE AND EVERY 0.1 SEC", on_progress=note)
    for _ in range(int(LIMIT_S / 0.1)):
        if len(seen) >= until:
            return command
        with pytest.raises(TimeoutError):
            command.wait(0.1)
    raise AssertionError(f"{len(seen)} poses within {LIMIT_S:.0f} s")


def await_connected(rtc: Client) -> None:
    for _ in range(int(LIMIT_S / 0.02)):
        if any(row.name == "S&P" and row.state == "connected" for row in rtc.status().subsystems):
            return
        zmq.Poller().poll(20)  # leave the processor to it
    raise AssertionError("S&P has not come back")


def test_a_displaced_module_is_located_by_its_pixels(rtc: Client) -> None:
    rtc.displace(MODULE, [0.02, -0.01, 0.0, 0.0, 0.0, math.radians(3.0)])
    ended = rtc.run(f"LOCATE {MODULE} REPORT POSE", timeout_s=LIMIT_S)
    assert ended.outcome.kind is OutcomeKind.SUCCEEDED, ended.outcome
    seen = ended.outcome.measured.sighting
    true = rtc.truth().poses[MODULE]
    assert 0.0 < geometry.distance(seen.pose, true) < 0.003  # never the true pose itself
    assert geometry.angle(seen.pose, true) < math.radians(1.0)
    facts = {fact.key: fact for fact in rtc.world.view().facts}
    fact = facts[f"{MODULE}.frame"]
    assert fact.value == pytest.approx(seen.pose, abs=1e-12)  # its quaternion is normalised once more
    off = geometry.relative(fact.value, true)
    errors = [*off[:3], *geometry.to_rpy(off)]
    assert all(abs(error) <= bound for error, bound in zip(errors, fact.spread, strict=True))


def test_a_blind_camera_states_that_it_is_dark(rtc: Client) -> None:
    name = rtc.inject(BlindCamera(camera="CAMERA-2")).active[0]
    try:
        outcome = rtc.run(f"LOCATE {MODULE}", timeout_s=LIMIT_S).outcome
    finally:
        rtc.undo_fault(name)
    assert outcome.kind is OutcomeKind.FAILED
    assert outcome.stop is StopReason.NOT_SEEN
    assert "too dark" in outcome.message  # wording: why a camera sees nothing


def test_a_module_that_drifts_is_not_grasped(rtc: Client) -> None:
    rtc.inject(Drifting(object="MACS-NEW", velocity=[0.0, 0.0, 0.003, 0.0, 0.0, 0.0]))
    try:
        outcome = rtc.run("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", timeout_s=LIMIT_S).outcome
    finally:
        rtc.undo_fault("ALL")
    assert outcome.kind is OutcomeKind.FAILED
    assert outcome.stop is StopReason.OUT_OF_RANGE
    (fact,) = rtc.world.view(keys=["MACS-NEW.frame"]).facts
    assert fact.validity is m.Validity.SUSPECT


def test_a_satellite_that_turns_by_itself_is_followed(rtc: Client, run_dir: Path) -> None:
    """Each pose is that of the time which its report states; so is the rate."""
    seen: list[m.ProgressNote] = []
    with turning(run_dir, rate_deg_s=3.0) as truths:
        ended = rtc.run("TRACK SATELLITE FOR 2 SEC REPORT POSE AND EVERY 0.1 SEC", seen.append, LIMIT_S)
    assert ended.outcome.kind is OutcomeKind.SUCCEEDED, ended.outcome
    poses = [one for one in seen if one.measured is not None and one.measured.sighting is not None]
    assert len(poses) > 3
    for one in poses:
        sighting = one.measured.sighting
        true = at(truths, one.at_s - sighting.age_s)
        assert geometry.distance(sighting.pose, true) < 0.003
        assert geometry.angle(sighting.pose, true) < math.radians(0.4)
    velocity = ended.outcome.measured.sighting.velocity
    assert velocity[3:] == pytest.approx([math.radians(3.0), 0.0, 0.0], abs=math.radians(0.4))


def test_a_halt_stops_a_look(rtc: Client) -> None:
    command = follow(rtc, until=3)
    result = rtc.halt("CAMERA-3")
    assert result.confirmed, result.message
    assert result.moving == ["CAMERA-3"]
    outcome = command.wait(LIMIT_S).outcome
    assert outcome.kind is OutcomeKind.HALTED
    assert outcome.stop is StopReason.HALT


def test_the_death_of_perception_is_a_true_outcome_and_cameras_are_soon_back(rtc: Client, run_dir: Path) -> None:
    command = follow(rtc, until=1)
    assert Chaos(run_dir, random.Random(1)).strike("any", "S&P") is not None
    outcome = command.wait(LIMIT_S).outcome
    assert outcome.kind is OutcomeKind.LOST_SUBSYSTEM
    await_connected(rtc)
    ended = rtc.run(f"LOCATE {MODULE}", timeout_s=LIMIT_S).outcome
    assert ended.kind is OutcomeKind.SUCCEEDED, ended


def test_a_stopped_process_is_found_and_replaced(rtc: Client, run_dir: Path) -> None:
    await_connected(rtc)
    (row,) = [row for row in rtc.status().processes if row.name == "S&P"]
    command = follow(rtc, until=1)
    os.kill(row.pid, signal.SIGSTOP)
    assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.LOST_SUBSYSTEM
