"""Draws a film of simulated scenes: `python -m sim_mcm.cameras.film --cell NAME --out FILE.gif`.

Each line of stdin is a frame in JSON (`FilmFrame`). It is drawn as soon as it arrives, by a process per core. At the
end of stdin the film is written: an animated GIF with one palette for all frames. It stores only the changes between
frames, so it is small: the walls and the floor do not move.
"""

from __future__ import annotations

import argparse
import functools
import multiprocessing
import os
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from pathlib import Path

import msgspec

from rtc.drawing.scene import FilmFrame, SceneView
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RtcError
from rtc.runtime.process import die_with_parent
from sim_mcm.cameras import picture as sheet
from sim_mcm.cameras.render import Camera, SceneRenderer

SIZE = (480, 360)
FRAMES_PER_S = 8.0
VIEW = "above"


def drawn(cell: str, frames: Iterable[FilmFrame]) -> list[sheet.Sheet]:
    """Each frame with its caption below, from VIEW. `cell`: name or file. Raises RtcError."""
    Cell.load(cell)  # a wrong name is an error here, and not in each process
    fresh = multiprocessing.get_context("spawn")  # pybullet does not survive a fork
    cores = len(os.sched_getaffinity(0))
    try:
        with ProcessPoolExecutor(cores, fresh, die_with_parent, (os.getpid(),)) as painters:
            return [picture.result() for picture in [painters.submit(_painted, cell, frame) for frame in frames]]
    except BrokenExecutor:
        raise RtcError("a process that draws has ended") from None


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


def main(arguments: Sequence[str] | None = None) -> None:
    words = argparse.ArgumentParser(prog="python -m sim_mcm.cameras.film", description=__doc__)
    words.add_argument("--cell", required=True, help="name or file of the cell")
    words.add_argument("--out", type=Path, required=True, help="the GIF to write")
    given = words.parse_args(arguments)
    try:
        frames = (msgspec.json.decode(line, type=FilmFrame) for line in sys.stdin.buffer)
        sheet.animate(drawn(given.cell, frames), given.out, FRAMES_PER_S)
    except (OSError, ValueError, msgspec.MsgspecError, RtcError) as error:
        words.exit(1, f"{words.prog}: {error}\n")


if __name__ == "__main__":
    main()
