"""The film of a run: an animated GIF, drawn by several processes."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from examples.swapout import film
from examples.swapout.filming import FilmFrame, FilmProgress
from rtc.drawing.scene import SceneView

WIDE_PX = 100


def frame(cell, turned_rad: float) -> FilmFrame:
    arm = cell.arms[0]
    joints = [arm.home_rad[0] + turned_rad, *arm.home_rad[1:]]
    return FilmFrame(scene=SceneView(poses={}, joints={arm.name: joints}), caption=f"{turned_rad}")


def made(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: str, frames: list[FilmFrame]) -> Path:
    lines = b"".join(msgspec.json.encode(frame) + b"\n" for frame in frames)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    out = folder / "film.gif"
    film.main(["--cell", cell, "--out", str(out)])
    return out


@pytest.mark.physics
def test_frames_are_in_their_order_whichever_process_has_drawn_them(tmp_path, cell, monkeypatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    with Image.open(
        made(monkeypatch, tmp_path, "swapout", [frame(cell, turn) for turn in (0.0, 0.5, 1.0)])
    ) as pictures:
        assert pictures.n_frames == 3
        pixels = []
        for n in range(3):
            pictures.seek(n)
            pixels.append(np.asarray(pictures.convert("L"), dtype=float))
    near, far = (float(np.abs(pixels[n] - pixels[0]).mean()) for n in (1, 2))
    assert 0.0 < near < far  # the arm turns away


def test_a_film_without_frames_ends_with_the_reason(monkeypatch, tmp_path, capsys) -> None:
    with pytest.raises(SystemExit):
        made(monkeypatch, tmp_path, "swapout", [])
    assert "needs a picture" in capsys.readouterr().err


def test_a_film_in_an_unknown_cell_ends_with_the_reason(monkeypatch, tmp_path, capsys) -> None:
    with pytest.raises(SystemExit):
        made(monkeypatch, tmp_path, "nowhere", [FilmFrame(scene=SceneView())])
    assert "nowhere" in capsys.readouterr().err


def niceness(fifo: str, frame: FilmFrame, file: Path) -> None:
    """In place of drawing: a picture as wide as the priority is low. Below its parent's priority it writes its niceness
    to the FIFO, and only "first" ends."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if own > os.getpriority(os.PRIO_PROCESS, os.getppid()):
        if frame.caption != "first":
            signal.pause()
        Path(fifo).write_text(str(own))
    Image.new("1", (WIDE_PX + own, 1)).save(file)


def test_after_the_last_frame_no_drawing_waits_for_other_processes(tmp_path, monkeypatch) -> None:
    """While frames arrive they are drawn at a low priority; beside busy processes that may take minutes."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if own == 19:
        pytest.skip("this process has the lowest priority itself")
    fifo = tmp_path / "niceness"
    os.mkfifo(fifo)
    meanwhile, reported = [], []

    def frames() -> Iterator[FilmFrame]:
        yield FilmFrame(scene=SceneView(), caption="first")
        meanwhile.append(int(fifo.read_text()))
        yield FilmFrame(scene=SceneView(), caption="last")

    monkeypatch.setattr(film, "NICENESS", 1)  # the lowest one would make this test slow beside busy processes
    monkeypatch.setattr(film, "_paint", niceness)
    monkeypatch.setattr(film.Cell, "load", lambda name: None)
    pictures = film.drawn(str(fifo), frames(), reported.append)
    assert meanwhile == [own + 1]
    assert pictures[-1].width == WIDE_PX + own
    assert reported[0] in [FilmProgress(drawn=0, frames=2), FilmProgress(drawn=1, frames=2)]
