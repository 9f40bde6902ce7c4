"""rtc picture: what a camera of the cell sees now. Cameras are simulated, so it needs a simulated MCM."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.cells.cell import Cell
from rtc.cells.scene import CameraPicture, centimetres, true_scene
from rtc.cli.output import AsJson, RunDir, console, emit_json, trouble
from rtc.client.client import Client
from rtc.language.alike import nearest_words
from rtc.protocol.outcomes import RtcError, TimedOut
from rtc.robot import geometry
from rtc.runtime.renderer import Renderer


def picture(
    camera: Annotated[str, typer.Argument(help="A camera of the cell, such as CAMERA-1.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The PNG file to write.", show_default="CAMERA-1.png")
    ] = None,
    json: AsJson = False,
    run_dir: RunDir = None,
) -> None:
    """The picture of one camera, as the running simulation shows it now.

    The cell file states where each camera is, its field of view, size, exposure and noise (`cameras:`), and where
    AprilTags are (`tags:`).

    Example:  rtc picture CAMERA-1
    Example:  rtc picture CAMERA-3 -o bay.png
    """
    with Client(run_dir, need_broker=False) as rtc:
        cell = Cell.load(rtc.settings.cell)
        name = _named(cell, camera)
        file = out or Path(f"{name}.png")
        if not file.absolute().parent.is_dir():
            raise trouble(f"there is no directory {file.absolute().parent} for the picture", 2)
        try:
            truth = rtc.truth()
        except TimedOut as error:
            raise RtcError("no picture: cameras are simulated, and this MCM does not report a true scene") from error
        scene = true_scene(truth)
        with Renderer() as renderer:
            renderer.draw(CameraPicture(out=str(file.absolute()), cell=rtc.settings.cell, camera=name, scene=scene))
        found = cell.camera(name)
        pose = found.pose if found.arm is None else geometry.compose(scene.tcp[found.arm], found.pose)
        if json:
            emit_json(
                {
                    "file": str(file),
                    "camera": name,
                    "pose": pose.tolist(),
                    "field_of_view_deg": found.field_of_view_deg,
                    "size_px": found.size_px,
                    "sim_s": truth.sim_s,
                }
            )
            return
        width, height = found.size_px
        words = f"{name} at {centimetres(pose)} cm: {width} x {height} pixels, {found.field_of_view_deg:g} deg high"
        console.print(Text(words))
        console.print(Text(f"picture: {file}"))


def _named(cell: Cell, wanted: str) -> str:
    """A camera's name; case and `_` are ignored. Raises typer.Exit."""
    name, known = wanted.upper().replace("_", "-"), [camera.name for camera in cell.cameras]
    if name in known:
        return name
    if not known:
        raise trouble(f"the cell {cell.name} has no cameras; name some under `cameras:` in its file", 2)
    near = nearest_words(name, known)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise trouble(f"no camera {wanted}; the cameras are {', '.join(known)}{hint}", 2)
