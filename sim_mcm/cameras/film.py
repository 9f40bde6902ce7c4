"""Draws a film of simulated scenes: `python -m sim_mcm.cameras.film --frames FILE.jsonl --cell NAME --out FILE.gif`.

One line of JSON per frame (`FilmFrame`). The result is an animated GIF with one palette for all frames. It stores only
the changes between frames, so it is small: the walls and the floor do not move. Each core draws a part of the frames.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import pybullet

from rtc.drawing.scene import FilmFrame
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import RtcError
from sim_mcm.cameras import picture as sheet
from sim_mcm.cameras.render import FAR_M, NEAR_M, Camera, SceneRenderer

SIZE = (480, 360)
FRAMES_PER_S = 8.0
FIELD_OF_VIEW_DEG = 38.0
EYE, TARGET = (-1.25, 0.0, 2.2), (0.42, 0.0, 0.63)  # from behind and above: both arms in full


def frames(file: Path) -> list[FilmFrame]:
    return [msgspec.json.decode(line, type=FilmFrame) for line in file.read_bytes().splitlines() if line]


def drawn(
    cell: Cell, wanted: Sequence[FilmFrame], eye: Sequence[float], target: Sequence[float]
) -> Iterator[sheet.Sheet]:
    """Each frame with its caption below."""
    studio = SceneRenderer(cell)
    camera = Camera(
        pybullet.computeViewMatrix(list(eye), list(target), [0, 0, 1]),
        pybullet.computeProjectionMatrixFOV(FIELD_OF_VIEW_DEG, SIZE[0] / SIZE[1], NEAR_M, FAR_M),
    )
    try:
        for frame in wanted:
            studio.pose(frame.scene)
            yield sheet.captioned(studio.photograph(camera, *SIZE).pixels, frame.caption)
    finally:
        studio.close()


def drawn_by_all_cores(cell: str, wanted: Sequence[FilmFrame]) -> list[sheet.Sheet]:
    """As `drawn`, from above the arms. `cell`: name or file. Raises RtcError."""
    size = math.ceil(len(wanted) / len(os.sched_getaffinity(0))) or 1
    parts = [_begin(cell, wanted[n : n + size]) for n in range(0, len(wanted), size)]
    return [picture for part in parts for picture in _end(part)]


def _begin(cell: str, wanted: Sequence[FilmFrame]) -> Connection:
    """Start a process that draws these frames. It ends when the other end of its pipe is closed."""
    fresh = multiprocessing.get_context("spawn")  # pybullet does not survive a fork
    pictures, there = fresh.Pipe(duplex=False)
    fresh.Process(target=_part, args=(there, cell, wanted), daemon=True).start()
    there.close()
    return pictures


def _part(there: Connection, cell: str, wanted: Sequence[FilmFrame]) -> None:
    try:
        there.send(list(drawn(Cell.load(cell), wanted, EYE, TARGET)))
    except RtcError as error:
        there.send(str(error))


def _end(pictures: Connection) -> list[sheet.Sheet]:
    try:
        found: list[sheet.Sheet] | str = pictures.recv()
    except EOFError:
        raise RtcError("a process that draws has ended") from None
    if isinstance(found, str):
        raise RtcError(found)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    words = argparse.ArgumentParser(prog="python -m sim_mcm.cameras.film", description=__doc__)
    words.add_argument("--frames", type=Path, required=True)
    words.add_argument("--cell", required=True, help="name or file of the cell")
    words.add_argument("--out", type=Path, required=True, help="the GIF to write")
    given = words.parse_args(arguments)
    try:
        sheet.animate(drawn_by_all_cores(given.cell, frames(given.frames)), given.out, FRAMES_PER_S)
    except (OSError, ValueError, msgspec.MsgspecError, RtcError) as error:
        words.exit(1, f"{words.prog}: {error}\n")


if __name__ == "__main__":
    main()
