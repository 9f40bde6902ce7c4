"""Pictures of a demo, drawn by another process at low priority while it goes on."""

from __future__ import annotations

from pathlib import Path

from rtc.apps.demos.narrator import Narrator
from rtc.drawing.renderer import Renderer
from rtc.drawing.scene import Panel, Picture, true_scene
from rtc.protocol import messages as m

RENDER_S = 600.0  # limit for a machine with many busy processes


class DemoPictures:
    """Pictures of the true scene in a cell."""

    def __init__(self, out: Path, renderer: Renderer, cell: str) -> None:
        self._out, self._renderer, self._cell = out, renderer, cell
        self._files: list[Path] = []
        out.mkdir(parents=True, exist_ok=True)

    def take(self, name: str, truth: m.SimTruthReply, camera: str = "overview", title: str = "") -> None:
        file = self._out / f"{name}.png"
        file.unlink(missing_ok=True)
        panels = [Panel(title=title or name, scene=true_scene(truth))]
        self._renderer.request(Picture(out=str(file.absolute()), cell=self._cell, panels=panels, camera=camera))
        self._files.append(file)

    def check(self, narrator: Narrator) -> None:
        """Wait for all pictures."""
        for file in self._files:
            narrator.check(f"picture {file}", self._renderer.drawn(RENDER_S) and file.is_file())
