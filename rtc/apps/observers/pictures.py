"""Pictures of the believed scene for a recording, at a low rate.

A process of its own draws them, at a lower priority than the recorder's. The recorder never waits for it.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from rtc.apps.observers.feed import Received
from rtc.drawing.renderer import Renderer
from rtc.drawing.scene import Believed, Picture, believed
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError
from rtc.runtime.process import Every

LOG = logging.getLogger("rtc record")
FORMAT = "jpeg"
STILL_S = 10.0  # period of pictures of a scene that does not change
DIGITS = 4  # of the m and rad that are compared: smaller changes are not visible


class PictureFile(Protocol):
    """Where the pictures go."""

    def add_picture(self, at_s: float, published_s: float, data: bytes, kind: str) -> None: ...


class RecordedPictures:
    """A sink of the recorder: draws what it receives, and adds the pictures to `to`. `name`: of the cell."""

    def __init__(self, name: str, cell: Cell, to: PictureFile, period_s: float) -> None:
        self._name, self._cell, self._to = name, cell, to
        self._facts: dict[str, m.Fact] = {}
        self._sample: m.Telemetry | None = None
        self._due = Every(period_s)
        self._last: object = None  # the scene drawn last
        self._ordered_s = 0.0  # when its picture was ordered
        self._awaited_s: float | None = None  # time of the sample that is drawn now
        self._folder = TemporaryDirectory(prefix="rtc-pictures-")
        self._out = Path(self._folder.name) / "scene.jpg"
        self._renderer: Renderer | None = Renderer().__enter__()
        self.count = 0

    @property
    def awaited(self) -> bool:
        """A picture is being drawn."""
        return self._awaited_s is not None

    def take(self, received: Received) -> None:
        match received.message:
            case m.View(facts=facts):
                self._facts |= {fact.key: fact for fact in facts}
            case m.Telemetry() as sample:
                self._sample = sample

    def flush_if_due(self, now_s: float) -> None:
        """Add the picture that is ready, then order the next one. A renderer that fails ends the pictures alone."""
        if self._renderer is None:
            return
        try:
            if self._awaited_s is not None and self._renderer.drawn(0.0):
                self._add(now_s, self._awaited_s)
            if self._awaited_s is None and self._sample is not None and self._due.due(now_s):
                self._order(self._renderer, self._sample, now_s)
        except (RtcError, OSError) as error:
            LOG.warning("the recording gets no more pictures: %s", error)
            self._end()

    def close(self) -> None:
        """End the renderer; a picture that is not ready is left out."""
        self._end()
        self._folder.cleanup()

    def _order(self, renderer: Renderer, sample: m.Telemetry, now_s: float) -> None:
        scene = believed(self._cell, self._facts, sample.arms, None)
        looks = _rounded(scene)
        if looks == self._last and now_s < self._ordered_s + STILL_S:
            return
        self._last, self._ordered_s, self._awaited_s = looks, now_s, sample.at_s
        renderer.request(picture(self._name, scene, self._out))

    def _add(self, now_s: float, published_s: float) -> None:
        self._awaited_s = None
        self._to.add_picture(now_s, published_s, self._out.read_bytes(), FORMAT)
        self.count += 1

    def _end(self) -> None:
        if self._renderer is not None:
            self._renderer.__exit__()
            self._renderer = None


def picture(cell: str, scene: Believed, out: Path) -> Picture:
    """The request to the renderer: the believed scene with the names of arms and objects."""
    caption = time.strftime("%Y-%m-%d %H:%M:%S")
    return Picture(out=str(out), cell=cell, panels=[scene.panel], caption=[caption], smooth=False)


def _rounded(scene: Believed) -> object:
    """What of the scene a picture shows, comparable."""
    parts = (scene.scene.poses, scene.scene.joints, scene.scene.fingers)
    values = [{name: [round(value, DIGITS) for value in part[name]] for name in part} for part in parts]
    return values, [(row.name, row.validity) for row in scene.objects], [(arm.name, arm.holding) for arm in scene.arms]
