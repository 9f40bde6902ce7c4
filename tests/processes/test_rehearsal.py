"""TEST sentences in a cluster: nothing reaches a subsystem, nothing is written, and a stale test is refused."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from broker.decisions.events import PrimitiveEnded, PrimitiveStarted
from broker.persistence.journal import Journal
from examples.swapout import swapout
from rtc.apps.cli import sentence_files
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.rehearsing import digest_of, rehearse
from rtc.protocol.outcomes import OutcomeKind, RefusalReason

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LINES = sentence_files.read(swapout.LINES)[:14]  # all: `tests.workers.rehearsal.test_swapout`
MOVE, STOW = "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN TIME-LIMIT 60 SEC", "STOW RIGHT-ARM"


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(cell="servicing", mcm="kinematic", speed="max", dim=2) as path:
        yield path


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as client:
        yield client


def rehearser(rtc: Client) -> int:
    """Process id of the rehearser."""
    return next(int(row.pid) for row in rtc.status().processes if row.name == "rehearser@0")


def test_a_list_of_sentences_reaches_no_subsystem_and_writes_nothing(rtc: Client, run_dir: Path):
    before, truth = rtc.world.view(), rtc.truth()
    ended = rehearse(rtc, [line.text for line in LINES], [line.label for line in LINES], keep_going=True)
    assert len(ended) == len(LINES)
    assert {one.outcome.kind for one in ended} == {OutcomeKind.SUCCEEDED, OutcomeKind.REFUSED}
    after = rtc.world.view()
    assert (after.version, after.facts) == (before.version, before.facts)
    assert (rtc.truth().joints, rtc.truth().poses) == (truth.joints, truth.poses)
    journal = Journal.read_only(run_dir / "journal.db")
    events = [event for batch in journal.batches(0) for event in batch]
    assert len(events) > 2 * len(LINES)
    assert not [event for event in events if isinstance(event, PrimitiveStarted | PrimitiveEnded)]


def test_a_killed_rehearser_repeats_its_job(rtc: Client):
    first = rtc.run(f"TEST {MOVE}")
    os.kill(rehearser(rtc), signal.SIGKILL)
    again = rtc.run(f"TEST {MOVE}")
    assert again.outcome.rehearsal == first.outcome.rehearsal


def test_a_tested_list_is_performed_and_is_stale_after_that(rtc: Client):
    ended = rtc.test([MOVE, STOW])
    digest = digest_of(ended, [MOVE, STOW])
    for text in (MOVE, STOW):
        done = rtc.run(text, if_tested=digest)
        assert done.outcome.kind is OutcomeKind.SUCCEEDED, done
    stale = rtc.run(MOVE, if_tested=digest).outcome
    assert stale.refusal is not None
    assert stale.refusal.reason is RefusalReason.STALE


def test_a_fact_that_another_command_has_changed_makes_a_test_stale(rtc: Client):
    digest = digest_of(rtc.test([STOW]), [STOW])
    assert rtc.run("MOVE LEFT-ARM TO BAY-2-FRONT").outcome.kind is OutcomeKind.SUCCEEDED
    refusal = rtc.run(STOW, if_tested=digest).outcome.refusal
    assert refusal is not None
    assert refusal.reason is RefusalReason.STALE
    assert refusal.where.startswith("LEFT-ARM.")
