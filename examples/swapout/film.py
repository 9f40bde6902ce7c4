"""Draws a film of simulated scenes: `python -m examples.swapout.film --cell NAME --out FILE.gif`.

Each line of stdin is a frame in JSON (`FilmFrame`). It is drawn as soon as it arrives, by a process per core, at the
lowest priority: what is filmed goes first. At the end of stdin nothing is left to be filmed. What is not drawn yet is
then drawn at normal priority, and stdout gets lines in JSON (`FilmProgress`). The film is an animated GIF with one
palette for all frames. It stores only the changes between frames, so it is small: the walls and the floor do not move.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from examples.swapout.filming import FilmFrame, FilmProgress
from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RtcError
from rtc.runtime.process import die_with_parent
from sim_mcm.cameras import picture as sheet
from sim_mcm.cameras.render import RenderCamera, SceneRenderer

SIZE = (480, 360)
FRAMES_PER_S = 8.0
VIEW = "above"
NICENESS = 19  # while frames arrive: drawn in the time that nothing else wants
PROGRESS_S = 5.0
FILM_COLOURS, FILM_ACCENTS = 72, 40
FILM_END_MS = 1500


def drawn(
    cell: str, frames: Iterable[FilmFrame], report: Callable[[FilmProgress], None] = lambda progress: None
) -> list[sheet.Sheet]:
    """Each frame with its caption below, from VIEW. `cell`: name or file. `frames` may block until the next one.

    `report` is called after the last of `frames`, if some are not drawn yet: at once, then every PROGRESS_S. Raises
    RtcError."""
    Cell.load(cell)  # a wrong name is an error here, and not in each process
    try:
        with tempfile.TemporaryDirectory() as folder:
            # Linux has a niceness per thread, and its processes inherit it. Only a privileged process takes it back.
            with ThreadPoolExecutor(1, initializer=os.nice, initargs=(NICENESS,)) as thread:
                pictures = thread.submit(_draw_meanwhile, cell, frames, Path(folder)).result()
            _draw_missing(cell, pictures, report)
            return [sheet.loaded(file) for file in pictures]
    except BrokenExecutor:
        raise RtcError("a process that draws has ended") from None


def _painters() -> ProcessPoolExecutor:
    fresh = multiprocessing.get_context("spawn")  # pybullet does not survive a fork
    return ProcessPoolExecutor(len(os.sched_getaffinity(0)), fresh, die_with_parent, (os.getpid(),))


def _draw_meanwhile(cell: str, frames: Iterable[FilmFrame], folder: Path) -> dict[Path, FilmFrame]:
    """All frames in their order, by the files of their pictures: those that are there when the last frame arrives.

    A painter writes its picture and hands over no more than that it is done, in less than PIPE_BUF bytes. Were one
    killed within a longer message, its reader would wait for the rest for ever."""
    pictures = {}
    with _painters() as painters:
        try:
            for n, frame in enumerate(frames):
                file = folder / f"{n}.png"
                pictures[file] = frame
                painters.submit(_paint, cell, frame, file)
        finally:
            for painter in multiprocessing.active_children():  # beside busy processes they would go on for minutes
                painter.kill()
    return pictures


def _draw_missing(cell: str, pictures: Mapping[Path, FilmFrame], report: Callable[[FilmProgress], None]) -> None:
    missing = [file for file in pictures if not file.exists()]
    if not missing:
        return
    drawn, reported_s = len(pictures) - len(missing), time.monotonic()
    report(FilmProgress(drawn=drawn, frames=len(pictures)))
    with _painters() as painters:
        for work in as_completed([painters.submit(_paint, cell, pictures[file], file) for file in missing]):
            work.result()
            drawn += 1
            if time.monotonic() >= reported_s + PROGRESS_S:
                reported_s = time.monotonic()
                report(FilmProgress(drawn=drawn, frames=len(pictures)))


def _paint(cell: str, frame: FilmFrame, file: Path) -> None:
    studio, camera = _studio(cell)
    studio.pose(frame.scene)
    sheet.save(sheet.captioned(studio.photograph(camera, *SIZE).pixels, frame.caption), file)


@functools.cache
def _studio(cell: str) -> tuple[SceneRenderer, RenderCamera]:
    """Of this process. The camera stays where it is."""
    studio = SceneRenderer(Cell.load(cell))
    studio.pose(SceneView())
    return studio, studio.camera(VIEW, SceneView(), SIZE[0] / SIZE[1])


def animate(pictures: Sequence[Image.Image], file: Path, frames_per_s: float) -> None:
    """An animated GIF with one palette; the last picture stays longer. Raises OSError; ValueError without pictures."""
    if not pictures:
        raise ValueError("a film needs a picture")
    some = Image.fromarray(np.concatenate([np.asarray(one) for one in pictures[:: max(1, len(pictures) // 8)]]))
    palette = _palette(some)
    flat = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures]
    times_ms = [round(1000.0 / frames_per_s)] * (len(flat) - 1) + [FILM_END_MS]
    file.parent.mkdir(parents=True, exist_ok=True)
    flat[0].save(file, format="GIF", save_all=True, append_images=flat[1:], duration=times_ms, loop=0, optimize=True)


def _palette(picture: Image.Image) -> Image.Image:
    """Most colours for large areas; the rest for small things in strong colours, such as handles."""
    areas = picture.quantize(FILM_COLOURS, Image.Quantize.MEDIANCUT).getpalette() or []
    things = picture.quantize(FILM_ACCENTS, Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*areas[: 3 * FILM_COLOURS], *things[: 3 * FILM_ACCENTS]])
    return palette


def _report(progress: FilmProgress) -> None:
    print(msgspec.json.encode(progress).decode(), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    words = argparse.ArgumentParser(prog="python -m examples.swapout.film", description=__doc__)
    words.add_argument("--cell", required=True, help="name or file of the cell")
    words.add_argument("--out", type=Path, required=True, help="the GIF to write")
    given = words.parse_args(arguments)
    try:
        frames = (msgspec.json.decode(line, type=FilmFrame) for line in sys.stdin.buffer)
        animate(drawn(given.cell, frames, _report), given.out, FRAMES_PER_S)
    except (OSError, ValueError, msgspec.MsgspecError, RtcError) as error:
        words.exit(1, f"{words.prog}: {error}\n")


if __name__ == "__main__":
    main()
