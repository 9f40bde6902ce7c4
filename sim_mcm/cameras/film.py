"""Draws a film of simulated scenes: `python -m sim_mcm.cameras.film --cell NAME --out FILE.gif`.

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
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from pathlib import Path

import msgspec

from rtc.drawing.scene import FilmFrame, FilmProgress, SceneView
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RtcError
from rtc.runtime.process import die_with_parent
from sim_mcm.cameras import picture as sheet
from sim_mcm.cameras.render import Camera, SceneRenderer

SIZE = (480, 360)
FRAMES_PER_S = 8.0
VIEW = "above"
NICENESS = 19  # while frames arrive: drawn in the time that nothing else wants
PROGRESS_S = 5.0


def drawn(
    cell: str, frames: Iterable[FilmFrame], report: Callable[[FilmProgress], None] = lambda progress: None
) -> list[sheet.Sheet]:
    """Each frame with its caption below, from VIEW. `cell`: name or file. `frames` may block until the next one.

    `report` is called after the last of `frames`, if some are not drawn yet: at once, then every PROGRESS_S. Raises
    RtcError."""
    Cell.load(cell)  # a wrong name is an error here, and not in each process
    try:
        # Linux has a niceness per thread, and its processes inherit it. Only a privileged process could take it back.
        with ThreadPoolExecutor(1, initializer=os.nice, initargs=(NICENESS,)) as thread:
            begun = thread.submit(_drawn_meanwhile, cell, frames).result()
        return _drawn_after(cell, begun, report)
    except BrokenExecutor:
        raise RtcError("a process that draws has ended") from None


def _painters() -> ProcessPoolExecutor:
    fresh = multiprocessing.get_context("spawn")  # pybullet does not survive a fork
    return ProcessPoolExecutor(len(os.sched_getaffinity(0)), fresh, die_with_parent, (os.getpid(),))


def _drawn_meanwhile(cell: str, frames: Iterable[FilmFrame]) -> list[tuple[FilmFrame, sheet.Sheet | None]]:
    """All frames, with those pictures that are there when the last frame arrives."""
    with _painters() as painters:
        try:
            begun = [(frame, painters.submit(_painted, cell, frame)) for frame in frames]
            return [(frame, picture.result() if picture.done() else None) for frame, picture in begun]
        finally:
            for painter in multiprocessing.active_children():  # beside busy processes they would go on for minutes
                painter.kill()


def _drawn_after(
    cell: str, begun: list[tuple[FilmFrame, sheet.Sheet | None]], report: Callable[[FilmProgress], None]
) -> list[sheet.Sheet]:
    """All pictures, with those that are not there yet."""
    sheets = {n: picture for n, (_, picture) in enumerate(begun) if picture is not None}
    if len(sheets) == len(begun):
        return list(sheets.values())
    reported_s = time.monotonic()
    report(FilmProgress(drawn=len(sheets), frames=len(begun)))
    with _painters() as painters:
        missing = {painters.submit(_painted, cell, frame): n for n, (frame, _) in enumerate(begun) if n not in sheets}
        for picture in as_completed(missing):
            sheets[missing[picture]] = picture.result()
            if time.monotonic() >= reported_s + PROGRESS_S:
                reported_s = time.monotonic()
                report(FilmProgress(drawn=len(sheets), frames=len(begun)))
    return [sheets[n] for n in range(len(begun))]


def _painted(cell: str, frame: FilmFrame) -> sheet.Sheet:
    studio, camera = _studio(cell)
    studio.pose(frame.scene)
    return sheet.captioned(studio.photograph(camera, *SIZE).pixels, frame.caption)


@functools.cache
def _studio(cell: str) -> tuple[SceneRenderer, Camera]:
    """Of this process. The camera stays where it is."""
    studio = SceneRenderer(Cell.load(cell))
    studio.pose(SceneView())
    return studio, studio.camera(VIEW, SceneView(), SIZE[0] / SIZE[1])


def _report(progress: FilmProgress) -> None:
    print(msgspec.json.encode(progress).decode(), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    words = argparse.ArgumentParser(prog="python -m sim_mcm.cameras.film", description=__doc__)
    words.add_argument("--cell", required=True, help="name or file of the cell")
    words.add_argument("--out", type=Path, required=True, help="the GIF to write")
    given = words.parse_args(arguments)
    try:
        frames = (msgspec.json.decode(line, type=FilmFrame) for line in sys.stdin.buffer)
        sheet.animate(drawn(given.cell, frames, _report), given.out, FRAMES_PER_S)
    except (OSError, ValueError, msgspec.MsgspecError, RtcError) as error:
        words.exit(1, f"{words.prog}: {error}\n")


if __name__ == "__main__":
    main()
