"""Pictures of the cell's cameras for pages: drawn on request by a process of their own, one at a time."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rtc.drawing.renderer import Renderer
from rtc.drawing.scene import CameraPicture, SceneView

KEPT_S = 0.4  # a younger picture of the same camera is not drawn again


class CameraPictures:
    """`take` may be called from any thread. `cell`: name or file of the cell."""

    def __init__(self, cell: str) -> None:
        self._cell = cell
        self._lock = threading.Lock()
        self._kept: dict[str, tuple[float, bytes]] = {}
        self._folder = TemporaryDirectory(prefix="rtc-console-")
        self._renderer: Renderer | None = None

    def take(self, camera: str, scene: SceneView) -> bytes:
        """A JPEG. Raises RtcError if it cannot be drawn."""
        with self._lock:
            at_s, kept = self._kept.get(camera, (0.0, b""))
            if kept and time.monotonic() < at_s + KEPT_S:
                return kept
            if self._renderer is None:
                self._renderer = Renderer(0).__enter__()
            out = Path(self._folder.name) / "camera.jpg"
            try:
                self._renderer.draw(CameraPicture(out=str(out), cell=self._cell, camera=camera, scene=scene))
            except Exception:
                self._end()
                raise
            picture = out.read_bytes()
            self._kept[camera] = time.monotonic(), picture
            return picture

    def close(self) -> None:
        with self._lock:
            self._end()
            self._folder.cleanup()

    def _end(self) -> None:
        if self._renderer is not None:
            self._renderer.__exit__()
            self._renderer = None
