"""rtc picture: what a camera of the cell sees now, and which bodies it locates. Cameras are simulated, so it needs a
simulated MCM; but the poses are from the pixels alone."""

from __future__ import annotations

import math
import secrets
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, emit_json, table
from rtc.client.client import Client
from rtc.drawing.renderer import ASKED_NICENESS, Renderer
from rtc.drawing.scene import CameraPicture, believed, centimetres, degrees, true_scene
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError, TimedOut
from rtc.protocol.spelling import unknown
from rtc.sensing import absence, optics
from rtc.sensing import locate as locator
from rtc.sensing.detector import TagDetector
from rtc.spatial import geometry

MEASURED_S = 1.0  # maximum wait for a telemetry sample of the arms


def picture(
    camera: Annotated[str, typer.Argument(help="A camera of the cell, such as CAMERA-1.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The PNG file to write.", show_default="CAMERA-1.png")
    ] = None,
    locate: Annotated[bool, typer.Option("--locate", help="Also locate bodies by their AprilTags.")] = False,
    json: AsJson = False,
    run_dir: RunDir = None,
) -> None:
    """The picture of one camera, as the running simulation shows it now.

    With --locate it also prints a table of the bodies with tags: pose from the pixels, its standard deviation, the
    distance from the believed pose, the tags. For a body that the camera does not see, it states the reason. The world
    database is not changed.

    The cell file states where each camera is, its field of view, size, exposure and noise (`cameras:`), and where
    AprilTags are (`tags:`).

    Example:  rtc picture CAMERA-1
    Example:  rtc picture CAMERA-3 -o bay.png
    Example:  rtc picture CAMERA-1 --locate
    """
    with Client(run_dir, need_broker=False) as rtc:
        cell = Cell.load(rtc.settings.cell)
        name = _named(cell, camera)
        file = out or Path(f"{name}.png")
        if not file.absolute().parent.is_dir():
            raise cli_error(f"there is no directory {file.absolute().parent} for the picture", 2)
        arms = _measured(rtc)
        try:
            truth = rtc.truth()
        except TimedOut as error:
            raise RtcError(
                "no picture: cameras are simulated, and no subsystem of arms reports a true scene"
            ) from error
        scene, found = true_scene(truth), cell.camera(name)
        seed = secrets.randbits(32)  # the picture and the pixels that are evaluated have the same noise
        with Renderer(ASKED_NICENESS) as renderer:
            renderer.draw(
                CameraPicture(out=str(file.absolute()), cell=rtc.settings.cell, camera=name, scene=scene, seed=seed)
            )
            pixels = renderer.photograph(rtc.settings.cell, name, scene, seed) if locate else None
        tcp = _tcp_of(found, arms)
        rows = [] if pixels is None else _located(cell, optics.view(found, tcp), pixels, _believed(rtc, cell, arms))
    pose = found.pose if tcp is None else geometry.compose(tcp, found.pose)
    if json:
        emit_json(
            {
                "file": str(file),
                "camera": name,
                "pose": pose.tolist(),
                "field_of_view_deg": found.field_of_view_deg,
                "size_px": found.size_px,
                "sim_s": truth.sim_s,
                **({"bodies": msgspec.to_builtins(rows)} if locate else {}),
            }
        )
        return
    if locate:
        if any(row.pose for row in rows):
            console.print(_table(rows))
        for row in rows:
            if row.pose is None:
                console.print(Text(f"{row.name} is not seen: {row.cause}", style="yellow"))
        console.print()
    width, height = found.size_px
    words = f"{name} at {centimetres(pose)} cm: {width} x {height} pixels, {found.field_of_view_deg:g} deg high"
    console.print(Text(words))
    console.print(Text(f"picture: {file}"))


def _tcp_of(camera: Camera, arms: dict[str, m.ArmSample]) -> list[float] | None:
    """Tcp pose of the arm that carries the camera; None for a fixed camera."""
    if camera.arm is None:
        return None
    if camera.arm not in arms:
        raise RtcError(f"{camera.name} is on {camera.arm}, whose position is not measured: no telemetry")
    return arms[camera.arm].tcp_pose


def _named(cell: Cell, wanted: str) -> str:
    """A camera's name; case and `_` are ignored. Raises typer.Exit."""
    name, known = wanted.upper().replace("_", "-"), [camera.name for camera in cell.cameras]
    if name in known:
        return name
    if not known:
        raise cli_error(f"the cell {cell.name} has no cameras; name some under `cameras:` in its file", 2)
    raise cli_error(unknown("camera", name, known), 2)


# --- bodies in the picture -----------------------------------------------------------------------------


class Located(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A body with tags. SI units; without a pose there is a cause."""

    name: str
    pose: list[float] | None = None
    covariance: list[list[float]] | None = None  # 6 x 6: position and small turn, world axes, m and rad
    off_m: float | None = None  # from the believed pose
    turned_rad: float | None = None
    tags: list[int] = []
    error_px: float | None = None
    ambiguous: bool = False  # a second attitude explains the picture nearly as well
    cause: str = ""


def _measured(rtc: Client) -> dict[str, m.ArmSample]:
    sample = next(rtc.telemetry(silence_s=MEASURED_S), None)
    return sample.arms if sample else {}


def _believed(rtc: Client, cell: Cell, arms: dict[str, m.ArmSample]) -> dict[str, list[float]]:
    """Believed poses of objects and seats, world frame."""
    facts = {fact.key: fact for fact in rtc.world.view().facts}
    scene = believed(cell, facts, arms, None).scene
    return {seat.name: seat.frame.pose.tolist() for seat in cell.seats} | scene.poses | scene.seats


def _located(
    cell: Cell, view: optics.CameraView, pixels: NDArray[np.uint8], poses: dict[str, list[float]]
) -> list[Located]:
    """One row for each body with tags, in the order of the cell file."""
    fits = locator.locate(cell.tags, [locator.Seen(view, TagDetector().find(pixels))])
    rows = []
    for name in dict.fromkeys(tag.body for tag in cell.tags):
        if (fit := fits.get(name)) is None:
            tags = [tag for tag in cell.tags if tag.body == name]
            rows.append(Located(name=name, cause=absence.cause(tags, poses[name], view, pixels)))
            continue
        rows.append(
            Located(
                name=name,
                pose=fit.pose.tolist(),
                covariance=fit.covariance.tolist(),
                off_m=geometry.distance(fit.pose, poses[name]),
                turned_rad=geometry.angle(fit.pose, poses[name]),
                tags=sorted(sighting.tag for sighting in fit.used),
                error_px=fit.best.error_px,
                ambiguous=fit.ambiguous,
            )
        )
    return rows


def _table(rows: list[Located]) -> Table:
    """The bodies that are seen."""
    columns = (
        "body",
        "x y z (cm)",
        "roll pitch yaw (deg)",
        "+- (mm, deg)>",
        "off by (mm, deg)>",
        "tags",
        "error (px)>",
    )
    out = table(*columns)
    for row in rows:
        if row.pose is None or row.covariance is None:
            continue
        deviations = np.sqrt(np.diag(row.covariance))
        out.add_row(
            row.name,
            centimetres(row.pose),
            degrees(row.pose) + (" ambiguous" if row.ambiguous else ""),
            f"{1e3 * max(deviations[:3]):.1f}, {math.degrees(max(deviations[3:])):.2f}",
            f"{1e3 * (row.off_m or 0.0):.1f}, {math.degrees(row.turned_rad or 0.0):.2f}",
            " ".join(map(str, row.tags)),
            f"{row.error_px:.2f}",
        )
    return out
