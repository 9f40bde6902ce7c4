"""Pictures of a recording: drawn by the real renderer, read back with the mcap package alone."""

from __future__ import annotations

import io
import sys

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from PIL import Image

from rtc.apps.observers import pictures
from rtc.apps.observers.pictures import STILL_S, RecordedPictures
from rtc.apps.observers.recording import Recording
from rtc.drawing import renderer
from tests.apps.observers.conftest import until
from tests.apps.observers.samples import T0, received, telemetry

pytestmark = pytest.mark.physics


@pytest.fixture
def made(tmp_path, cell):
    recording = Recording(tmp_path / "run.mcap", cell, {"cell": "swapout"}, rate_hz=20, shares_clock=True)
    drawn = RecordedPictures("swapout", cell, recording, period_s=1.0)
    yield drawn, recording
    drawn.close()


def images(path) -> list[CompressedImage]:
    with open(path, "rb") as file:
        found = make_reader(file).iter_messages(topics=["/picture"])
        return [CompressedImage.FromString(message.data) for _, _, message in found]


def draw(drawn: RecordedPictures, at_s: float, number: int) -> None:
    until(lambda: drawn.flush_if_due(at_s) or drawn.count == number)


def test_a_picture_shows_the_arms_where_they_were(made, tmp_path):
    drawn, recording = made
    for n, joint in enumerate((0.0, 1.2), start=1):
        drawn.take(received(telemetry(float(n), joint)))
        draw(drawn, T0 + n, n)
    recording.close()
    first, second = images(tmp_path / "run.mcap")
    assert first.format == "jpeg"
    assert second.timestamp.ToNanoseconds() - first.timestamp.ToNanoseconds() == pytest.approx(1e9, abs=1e3)
    shown = [Image.open(io.BytesIO(image.data)).convert("RGB") for image in (first, second)]
    assert all(picture.size >= (640, 480) for picture in shown)
    assert all(len(picture.getcolors(1 << 20)) > 1000 for picture in shown)
    assert shown[0].tobytes() != shown[1].tobytes()


def test_a_scene_that_does_not_change_is_drawn_seldom(made):
    drawn, _ = made
    drawn.take(received(telemetry(1.0, 0.5)))
    draw(drawn, T0, 1)
    drawn.flush_if_due(T0 + 2)
    assert not drawn.awaited
    drawn.flush_if_due(T0 + STILL_S)
    assert drawn.awaited


def test_a_renderer_that_fails_ends_the_pictures_alone(cell, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(renderer, "COMMAND", [sys.executable, "-c", ""])
    recording = Recording(tmp_path / "run.mcap", cell, {"cell": "swapout"}, rate_hz=20, shares_clock=True)
    drawn = RecordedPictures("swapout", cell, recording, period_s=1.0)
    sample = received(telemetry(1.0, 0.5))
    drawn.take(sample)
    until(lambda: drawn.flush_if_due(T0 + 1) or caplog.records)
    recording.take(sample)
    drawn.flush_if_due(T0 + 2)
    drawn.close()
    recording.close()
    assert pictures.LOG.name in {record.name for record in caplog.records}
    with open(tmp_path / "run.mcap", "rb") as file:
        assert {channel.topic for _, channel, _ in make_reader(file).iter_messages()} >= {"/tf"}
