"""What the supervisor hands to its processes, and the lock of each role."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.cluster import _lock
from rtc.runtime.handover import Handover, claim_role, load
from rtc.runtime.settings import Settings

HOLDER = """
import sys, signal
from pathlib import Path
from rtc.runtime.handover import claim_role
held = claim_role("broker", Path(sys.argv[1]), -1)
print("held", flush=True)
signal.pause()
"""


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    settings = Settings(run_dir=str(tmp_path), run="r1")
    settings.save()
    return settings


@pytest.fixture
def holder(settings: Settings) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", HOLDER, settings.run_dir], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


def test_a_second_process_of_a_role_ends_with_a_sentence(settings: Settings, holder: subprocess.Popen[bytes]) -> None:
    with pytest.raises(SystemExit, match=r"has its broker already; a second one is not started"):
        claim_role("broker", settings.path, -1)
    claim_role("world", settings.path, -1)  # another role


def test_the_lock_dies_with_its_process(settings: Settings, holder: subprocess.Popen[bytes]) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    claim_role("broker", settings.path, -1)


def test_a_process_started_by_hand_gives_way_to_a_cluster(settings: Settings) -> None:
    with _lock(settings.path), pytest.raises(SystemExit, match=r"a cluster runs in .*, and has its own MCM"):
        claim_role("MCM", settings.path, -1)


def test_without_settings_a_process_ends_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"no settings.json: start a cluster with: rtc up"):
        load(tmp_path, -1)


def test_what_was_handed_over_does_not_need_the_directory(settings: Settings) -> None:
    given = Handover.make(settings, b"k" * 32, "token")
    (settings.path / "settings.json").unlink()
    taken = load(settings.path, given.fd)
    assert (taken.settings, taken.lease_key, taken.token) == (settings, b"k" * 32, "token")
    assert taken.identity("MCM") == "MCM@token"
    assert taken.identity("binder@2") == "binder@2"


def test_a_role_remembers_across_its_lives(settings: Settings) -> None:
    given = Handover.make(settings, b"k" * 32, "token")
    first = load(settings.path, given.fd)
    assert first.remembered("broker") is None
    first.save_counters("broker", b"k7f2", 12, 3)
    assert load(settings.path, given.fd).remembered("broker") == (b"k7f2", 12, 3)
    assert load(settings.path, given.fd).remembered("world") is None
