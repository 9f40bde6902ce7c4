"""A recording, read back with the mcap package alone: with its index, and cut off at any byte."""

from __future__ import annotations

import io
import json
import random
import struct
from contextlib import suppress

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

from rtc.apps.observers import playback
from rtc.apps.observers.feed import Received
from rtc.apps.observers.recording import HEADER, STILL_S, Recording
from rtc.protocol import messages as m
from tests.apps.observers.samples import DECLINED, HALTED, STEP, STOWED, T0, received, telemetry

ABOUT = {"cluster": "abcd", "cell": "swapout"}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


def recording(path, cell) -> Recording:
    return Recording(path, cell, ABOUT, rate_hz=20, shares_clock=True)


def write(made: Recording) -> None:
    for n in range(10):
        made.take(received(telemetry(0.1 * n, 0.1 * n)))
    for message in STOWED:
        made.take(received(message))


@pytest.fixture
def written(path, cell):
    made = recording(path, cell)
    write(made)
    made.close()
    return path


def by_topic(path) -> dict[str, list]:
    found: dict[str, list] = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, *_ in reader.iter_messages():
            assert schema is not None
            if channel.message_encoding == "protobuf":
                decode = DecoderFactory().decoder_for("protobuf", schema)
                found.setdefault(channel.topic, []).append(decode(message.data))
            else:
                found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found


def test_the_run_is_rebuilt_from_the_file_alone(written):
    found = by_topic(written)
    assert [(end["command"], end["text"], end["outcome"]["kind"]) for end in found["/rtc/outcomes"]] == [
        ("C-1", "STOW LEFT-ARM", "succeeded"),
        ("C-2", "GRAPS", "refused"),
    ]
    assert found["/rtc/outcomes"][1]["outcome"]["refusal"]["nearest"] == ["GRASP"]
    assert [note["phase"] for note in found["/rtc/progress"]][:5] == [
        "parsing",
        "elaborating",
        "binding",
        "executing",
        "analyzing",
    ]
    last = {joint.name: joint.position for joint in found["/joint_states"][-1].joints}
    assert last["LEFT-ARM/joint_1"] == pytest.approx(0.9)
    assert last["RIGHT-ARM/finger_a_slide"] == pytest.approx(0.02)
    frames = {(move.parent_frame_id, move.child_frame_id) for move in found["/tf"][-1].transforms}
    assert ("world", "LEFT-ARM/pedestal") in frames
    assert ("LEFT-ARM/pedestal", "LEFT-ARM/shoulder") in frames


def test_refused_requests_and_halts_of_resting_arms_are_in_the_file(path, cell):
    made = recording(path, cell)
    for message in (DECLINED, HALTED):
        made.take(received(message))
    made.close()
    found = by_topic(path)
    (refused,), (halt,), (event,) = found["/rtc/refusals"], found["/rtc/halts"], found["/events"]
    assert (refused["text"], refused["refusal"]["clears"]) == ("STOW RIGHT-ARM", [{"words": "rtc up"}])
    assert halt["scope"] == "ALL"
    assert "refused" not in halt
    assert {pair.key: pair.value for pair in event.metadata} == {"halt": "H-1", "scope": "ALL"}
    story = list(playback.in_words(playback.read(path)))
    assert any("STOW RIGHT-ARM" in line and "rtc up" in line for line in story)
    assert any("HALT ALL" in line for line in story)


def test_objects_are_where_the_cluster_believes_them(path, cell):
    made = recording(path, cell)
    made.take(received(telemetry(0.0, 0.1)))
    believed = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
    fact = m.Fact(key="MACS-OLD.frame", value=believed, validity=m.Validity.VALID, version=2, source="C-1/1", at_s=T0)
    made.take(Received(T0, m.View(request="facts", version=2, facts=[fact])))
    made.take(received(telemetry(1.0, 0.2)))
    made.close()
    places = []
    for sample in by_topic(path)["/tf"]:
        (move,) = (move for move in sample.transforms if move.child_frame_id == "MACS-OLD")
        places.append([move.translation.x, move.translation.y, move.translation.z])
    assert places[0] == pytest.approx(cell.object_pose("MACS-OLD")[:3])
    assert places[1] == pytest.approx(believed[:3])


def test_an_event_lasts_from_acceptance_to_the_end(written):
    event = by_topic(written)["/events"][0]
    duration = event.end_time.ToNanoseconds() - event.start_time.ToNanoseconds()
    assert duration == pytest.approx(1.05e9, abs=1e3)
    assert {pair.key: pair.value for pair in event.metadata}["sentence"] == "STOW LEFT-ARM"


def test_viewers_find_their_schemas_and_the_models(written):
    with open(written, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        schemas = {schema.name: schema.encoding for schema in summary.schemas.values()}
        attached = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
    for name in ("FrameTransforms", "JointStates", "Log", "Event"):
        assert schemas[f"foxglove.{name}"] == "protobuf"
    for name in ("ProgressNote", "CommandEnded", "ArmSample"):
        assert schemas[f"rtc.{name}"] == "jsonschema"
    assert b"LEFT-ARM/joint_1" in attached["LEFT-ARM.urdf"]
    assert set(attached) == {"LEFT-ARM.urdf", "RIGHT-ARM.urdf", "cell.json"}


def test_arms_that_stand_still_are_written_seldom(path, cell):
    made = recording(path, cell)
    for n in range(100):
        made.take(received(telemetry(0.02 * n, 0.5)))
    made.close()
    assert len(by_topic(path)["/tf"]) == int(2.0 / STILL_S)


def messages_of(data: bytes) -> list[bytes]:
    """All messages of a file that may be cut off, with the mcap package's stream reader."""
    found = []
    try:
        for record in StreamReader(io.BytesIO(data)).records:
            if isinstance(record, Message):
                found.append(record.data)
            else:
                assert not isinstance(record, Channel) or record.topic
    except (EndOfFile, struct.error):  # the package raises the second if a length is cut off
        pass
    return found


def test_a_file_that_was_cut_off_anywhere_is_readable_up_to_there(path, cell):
    made = recording(path, cell)
    write(made)
    made.flush_if_due(T0)  # the first one is due
    first = path.read_bytes()
    whole = messages_of(first)
    assert whole
    made.take(received(telemetry(5.0, 1.5)))
    made.flush_if_due(T0 + 100)
    second = path.read_bytes()
    made.close()
    assert second.startswith(first)
    assert len(messages_of(second)) > len(whole)
    for length in range(len(first), len(second)):  # killed while the second chunk is written
        assert messages_of(second[:length])[: len(whole)] == whole
    path.write_bytes(second[:-1])
    found = playback.read(path)
    assert not found.complete
    assert {name: end.outcome.kind.value for name, end in found.outcomes.items()} == {
        "C-1": "succeeded",
        "C-2": "refused",
    }


def test_the_story_has_commands_phases_and_ends_in_order(written, tmp_path):
    found = playback.read(written)
    assert found.complete
    lines = list(playback.in_words(found))
    order = [
        next(n for n, line in enumerate(lines) if word in line) for word in ("parsing", STEP, "SUCCEEDED", "REFUSED")
    ]
    assert order == sorted(order)
    times = [at_s for at_s, _ in found.events]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(1.21, abs=1e-3)
    paths, left_out = playback.extract(found, tmp_path / "models")
    assert not left_out
    assert {path.name for path in paths} == {"LEFT-ARM.urdf", "RIGHT-ARM.urdf", "cell.json"}


def test_another_file_is_refused(tmp_path):
    other = tmp_path / "other.mcap"
    other.write_bytes(b"not an mcap file, but long enough to be one")
    with pytest.raises(playback.NotARecording):
        playback.read(other)


def test_a_file_is_never_overwritten(written, cell):
    before = written.read_bytes()
    with pytest.raises(FileExistsError):
        recording(written, cell)
    assert written.read_bytes() == before


def foreign(path, write_records) -> None:
    """A file of another writer, with the header of a recording."""
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_metadata(HEADER, ABOUT)
        write_records(writer)
        writer.finish()


def test_attachments_that_are_not_names_of_files_are_left_out(path, tmp_path):
    odd = ["..", ".", "", "../out.txt", "/tmp/x", "a\0b", "x" * 300]
    foreign(path, lambda writer: [writer.add_attachment(0, 0, name, "", b"x") for name in [*odd, "arm.urdf"]])
    paths, left_out = playback.extract(playback.read(path), tmp_path / "models")
    assert [file.name for file in paths] == ["arm.urdf"]
    assert left_out == odd
    assert [file.name for file in (tmp_path / "models").iterdir()] == ["arm.urdf"]


def test_a_chunk_that_unpacks_to_much_is_not_unpacked(path):
    def write_zeros(writer: Writer) -> None:
        channel = writer.register_channel("/zeros", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b"\0" * (playback.CHUNK_BYTES + 1), 0)

    foreign(path, write_zeros)
    with pytest.raises(playback.NotARecording, match="limit"):
        playback.read(path)


def test_a_story_that_does_not_fit_into_memory_is_refused(written, monkeypatch):
    monkeypatch.setattr(playback, "STORY_BYTES", 100)
    with pytest.raises(playback.NotARecording, match="Foxglove"):
        playback.read(written)


def test_a_damaged_file_is_refused_or_read_never_a_traceback(written):
    """Bytes are changed at places all over the file; lengths, channel numbers and packed chunks among them."""
    whole, dice = written.read_bytes(), random.Random(1)
    for _ in range(400):
        damaged = bytearray(whole)
        for _ in range(dice.choice((1, 8))):
            damaged[dice.randrange(len(whole))] = dice.randrange(256)
        written.write_bytes(damaged)
        with suppress(playback.NotARecording):
            playback.read(written)


@pytest.mark.parametrize("body", [b'{"x":' + b"[" * 200_000, b"\xff\xfe{"])
def test_a_message_that_is_no_json_is_refused(path, body):
    def write_outcome(writer: Writer) -> None:
        schema = writer.register_schema("x", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/rtc/outcomes", "json", schema), 0, body, 0)

    foreign(path, write_outcome)
    with pytest.raises(playback.NotARecording):
        playback.read(path)
