"""The recorder beside a real cluster: killed with SIGKILL, its files contain all that had been written."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
from contextlib import suppress
from pathlib import Path

import msgpack
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from rtc import Client
from rtc.apps.observers import playback, recorder
from rtc.runtime import extras, process_table
from tests.apps.cli.in_process import call
from tests.apps.observers.conftest import RTC, rtc, until

pytestmark = [pytest.mark.slow, pytest.mark.untimed]


def json_messages(path: Path) -> list[tuple[str, dict]]:
    """(topic, message) of all JSON messages in a file that may be cut off, read with the mcap package alone."""
    channels: dict[int, Channel] = {}
    found = []
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message) and channels[record.channel_id].message_encoding == "json":
                    found.append((channels[record.channel_id].topic, json.loads(record.data)))
        except (EndOfFile, struct.error):
            pass
    return found


def topics(path: Path) -> set[str]:
    """The topics of a file that may be cut off."""
    found = set()
    with open(path, "rb") as file, suppress(EndOfFile, struct.error):
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                found.add(record.topic)
    return found


def ended_in(path: Path) -> dict[str, tuple[str, str]]:
    """Command -> (sentence, outcome)."""
    ends = [message for topic, message in json_messages(path) if topic == "/rtc/outcomes"]
    return {end["command"]: (end["text"], end["outcome"]["kind"]) for end in ends}


def raw_events(path: Path) -> list[dict]:
    with open(path, "rb") as file:
        return list(msgpack.Unpacker(file))


def test_a_killed_recorder_leaves_the_run_up_to_then(watched, tmp_path):
    mcap, raw = tmp_path / "run.mcap", tmp_path / "events.msgpack"
    command = [*RTC, "record", "-o", str(mcap), "--raw", str(raw), "--pictures", "1"]
    command += ["--run-dir", str(watched.run_dir)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as observer, Client(watched.run_dir) as client:
        try:
            until(lambda: client.run("GRAPS MACS-NEW") and raw.exists() and raw.stat().st_size)  # it is subscribed
            stowed = client.run("STOW LEFT-ARM")
            refused = client.run("GRAPS MACS-NEW")
            client.halt("ALL")
            sample = next(client.telemetry())
            until(lambda: {stowed.command, refused.command} <= ended_in(mcap).keys())
            until(lambda: _last_joints(mcap) == pytest.approx(sample.arms["LEFT-ARM"].joints, abs=1e-4))
            until(lambda: refused.command in {event["command"] for event in raw_events(raw) if "outcome" in event})
            until(lambda: {"/picture", "/rtc/halts"} <= topics(mcap))
        finally:
            observer.kill()
    found = ended_in(mcap)
    assert found[stowed.command] == ("STOW LEFT-ARM", "succeeded")
    assert found[refused.command] == ("GRAPS MACS-NEW", "refused")
    assert not playback.read(mcap).complete
    events = [event for event in raw_events(raw) if event.get("command") == stowed.command]
    numbers = [event["seq"] for event in events]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert events[-1]["type"] == "CommandEnded"
    notes = [note for topic, note in json_messages(mcap) if topic == "/rtc/progress"]
    assert [note["seq"] for note in notes if note["command"] == stowed.command] == numbers[:-1]


def _last_joints(path: Path) -> list[float]:
    samples = [message for topic, message in json_messages(path) if topic == "/rtc/arms/LEFT-ARM"]
    return samples[-1]["joints"] if samples else []


def test_a_recorder_that_was_started_with_the_cluster_comes_back_with_a_new_file(watched):
    def files() -> list[Path]:
        return sorted(watched.recordings.glob("*.mcap"), key=lambda path: path.stat().st_mtime)

    def pid() -> int:
        table = process_table.Table.load(watched.run_dir)
        return next((row.pid for row in table.processes if row.name == "recorder"), 0) if table else 0

    first, old = files(), pid()
    with Client(watched.run_dir) as client:
        ended = client.run("STOW RIGHT-ARM")
        until(lambda: ended.command in ended_in(first[-1]))
        os.kill(old, signal.SIGKILL)
        until(lambda: len(files()) > len(first))
        later: set[str] = set()
        until(lambda: later.add(client.run("GRAPS MACS-NEW").command) or later & ended_in(files()[-1]).keys())
    assert ended_in(first[-1])[ended.command] == ("STOW RIGHT-ARM", "succeeded")


def test_play_shows_the_story_of_a_recording(watched, tmp_path):
    path = tmp_path / "run.mcap"
    rtc("record", "-o", path, "--for", "1s", "--run-dir", watched.run_dir)
    shown = json.loads(call("play", str(path), "--json").stdout.splitlines()[-1])
    assert shown["complete"]
    assert set(shown["arms"]) == {"LEFT-ARM", "RIGHT-ARM"}


@pytest.mark.parametrize("option", ["-o", "--raw"])
def test_a_recording_without_a_directory_for_it_does_not_begin(watched, tmp_path, monkeypatch, option):
    place = tmp_path / "absent" / "run"
    monkeypatch.chdir(tmp_path)
    found = call("record", option, str(place), "--run-dir", str(watched.run_dir))
    assert found.returncode == 2
    assert str(place.parent) in found.stderr + found.stdout
    assert not list(tmp_path.iterdir())


def test_a_missing_library_is_named_with_its_cure(monkeypatch):
    monkeypatch.setitem(extras.EXTRAS, "record", ("mcap", "no_such_package.inside"))
    need = extras.missing("record")
    assert "no_such_package" in need
    assert "pip install" in need
    assert "mcap-protobuf-support" in need


def test_a_free_name_is_found(tmp_path):
    path = tmp_path / "a.mcap"
    for n in ("a.mcap", "a-2.mcap"):
        assert recorder.unused(path).name == n
        recorder.unused(path).touch()
    assert recorder.unused(path).name == "a-3.mcap"


def test_a_recording_without_a_message_has_no_time() -> None:
    lines = list(playback.in_words(playback.RecordedRun(about={"cell": "swapout"})))
    assert "without a message" in lines[0]
