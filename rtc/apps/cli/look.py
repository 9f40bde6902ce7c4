"""rtc look: a picture and a table of the current scene, believed and true."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_file
from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, duration_s, emit_json, errors, table
from rtc.apps.cli.world import COLOUR
from rtc.client.client import Client
from rtc.drawing.renderer import ASKED_NICENESS, Renderer
from rtc.drawing.scene import (
    VIEWS,
    ArmRow,
    Believed,
    ObjectRow,
    Panel,
    Picture,
    believed,
    centimetres,
    degrees,
    true_scene,
)
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import KeyTrouble, TimedOut
from rtc.protocol.primitive_id import command_of
from rtc.protocol.spelling import unknown
from rtc.runtime import process

MEASURED_S = 1.0  # maximum wait for a telemetry sample of the arms; there are 50 per second
SEEN_M, SEEN_RAD = 0.002, math.radians(1.0)  # differences above these get an outline
REPORTED_M = 0.0005  # differences above this are printed


def look(
    out: Annotated[Path, typer.Option("-o", "--out", help="The PNG file to write.")] = Path("scene.png"),
    watch: Annotated[bool, typer.Option("--watch", help="Draw it repeatedly, until Ctrl-C.")] = False,
    every: Annotated[str, typer.Option(help="With --watch: the period, such as 1s or 500ms.")] = "1s",
    for_: Annotated[
        str, typer.Option("--for", help="With --watch: the duration, such as 60s or 5m.", show_default="for ever")
    ] = "",
    camera: Annotated[
        str, typer.Option(help=f"{', '.join(VIEWS)}; or an arm, object, seat or place: a close view.")
    ] = "overview",
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """A picture of the current scene, and a table of all positions (cm, deg).

    The left half shows the believed scene. With a simulated MCM the right half shows the true one; a magenta outline
    marks the believed place of an object that is elsewhere. With --watch the file is rewritten every second, and most
    picture viewers reload it.

    Example:  rtc look
    Example:  rtc look -o hand.png --camera RIGHT-ARM
    Example:  rtc look --watch --for 60s
    """
    every_s, for_s = duration_s(every, "--every"), duration_s(for_, "--for") if for_ else math.inf
    process.nice(ASKED_NICENESS)  # with its renderer; without the permission a busy machine makes it wait
    if (folder := out.absolute().parent) and not folder.is_dir():
        raise cli_error(f"there is no directory {folder} for the picture", 2)
    with (
        Client(run_dir, need_broker=bool(key), key=key) as rtc,
        cell_file(rtc.cell()) if key else nullcontext(rtc.settings.cell) as name,
    ):
        cell = Cell.load(name)
        view = _camera(cell, camera)
        eye = _Eye(rtc, cell)
        with Renderer(0) as renderer:
            scene, truth = eye.see()
            renderer.draw(picture(name, scene, truth, out, view))
            if not watch:
                _show(scene, truth, out, json)
                return
            try:
                _watch(eye, renderer, name, out, view, every_s, for_s)
            except KeyboardInterrupt:
                console.print(f"{out} shows the last scene")


class _Eye:
    """The visible state of a cluster: facts, measurements, and the true state of a simulator."""

    def __init__(self, rtc: Client, cell: Cell) -> None:
        self._rtc, self._cell = rtc, cell
        self._bench = True

    def see(self) -> tuple[Believed, m.SimTruthReply | None]:
        """Raises ClusterError if the world database does not answer."""
        facts = {fact.key: fact for fact in self._rtc.world.view().facts}
        sample = next(self._rtc.telemetry(silence_s=MEASURED_S), None)
        truth = self._truth()
        return believed(self._cell, facts, sample.arms if sample else {}, truth), truth

    def _truth(self) -> m.SimTruthReply | None:
        if not self._bench:
            return None
        try:
            return self._rtc.truth()
        except (TimedOut, KeyTrouble) as error:  # real arms, an MCM that restarts, or access by a key
            self._bench = isinstance(error, TimedOut)
            errors.print("rtc: the true state is not known; the picture shows the believed one")
            return None


def _watch(eye: _Eye, renderer: Renderer, cell: str, out: Path, view: str, every_s: float, for_s: float) -> None:
    begun_s = next_s = time.monotonic()
    while time.monotonic() < begun_s + for_s:
        scene, truth = eye.see()
        renderer.draw(picture(cell, scene, truth, out, view, smooth=False))
        console.print(Text(f"{time.strftime('%H:%M:%S')}  {out}  {'; '.join(in_words(scene))}"))
        next_s = max(next_s + every_s, time.monotonic())
        time.sleep(max(0.0, min(next_s, begun_s + for_s) - time.monotonic()))


def _camera(cell: Cell, wanted: str) -> str:
    """A view or a name of the cell; case is ignored. Raises typer.Exit."""
    if wanted.lower() in VIEWS:
        return wanted.lower()
    name = wanted.upper().replace("_", "-")
    known = [*cell.names()]
    others = {part.name for group in (cell.regions, cell.cameras) for part in group}
    if name in known and name not in others:
        return name
    raise cli_error(unknown("view, arm, object, seat or place", wanted, [*VIEWS, *(set(known) - others)]), 2)


# --- the picture ---------------------------------------------------------------------------------------


def picture(
    cell: str, scene: Believed, truth: m.SimTruthReply | None, out: Path, camera: str, *, smooth: bool = True
) -> Picture:
    """The request to the renderer: the believed scene and, if known, the true one beside it."""
    panels = [scene.panel]
    if truth is not None:
        labels = {
            arm.name: arm.name + (f" holds {', '.join(held)}" if (held := arm.truly_holding or []) else "")
            for arm in scene.arms
        }
        labels |= {row.name: f"{row.name} {_off(row)}" if differs(row) else row.name for row in scene.objects}
        moved = [row.name for row in scene.objects if differs(row)]
        title = "true (from the simulator)" + ("; magenta: believed place" if moved else "")
        panels.append(Panel(title=title, scene=true_scene(truth), labels=labels, doubtful=moved, outlined=moved))
    return Picture(
        out=str(out.absolute()),
        cell=cell,
        panels=panels,
        camera=camera,
        caption=[time.strftime("%Y-%m-%d %H:%M:%S   ") + "; ".join(in_words(scene))],
        smooth=smooth,
    )


def differs(row: ObjectRow) -> bool:
    """True if the difference to the truth is visible."""
    return (row.off_m or 0.0) > SEEN_M or (row.turned_rad or 0.0) > SEEN_RAD


def in_words(scene: Believed) -> list[str]:
    """Notable facts in words: motions, held objects, doubtful facts, differences from the believed state."""
    phrases = []
    for arm in scene.arms:
        parts = [f"moves ({command_of(arm.moving)})"] if arm.moving else []
        parts += [f"holds {arm.holding}"] if arm.holding else []
        if arm.truly_holding is not None and arm.truly_holding != [arm.holding][: len(arm.holding)]:
            parts.append(f"truly holds {', '.join(arm.truly_holding) or 'nothing'}")
        phrases += [f"{arm.name} {', '.join(parts)}"] if parts else []
    for row in scene.objects:
        words = [row.doubt.strip()] if row.doubt else []
        words += [_off(row)] if (row.off_m or 0.0) > REPORTED_M or differs(row) else []
        phrases += [f"{row.name} {', '.join(words)}"] if words else []
    return phrases or ["nothing moves" + ("; every object is at its believed place" if _known(scene) else "")]


def _known(scene: Believed) -> bool:
    return any(row.off_m is not None for row in scene.objects)


def _off(row: ObjectRow) -> str:
    """A difference as text: 31.0 mm off, turned 4.0 deg."""
    turned_deg = math.degrees(row.turned_rad or 0.0)
    return f"{1e3 * (row.off_m or 0.0):.1f} mm off" + (f", turned {turned_deg:.1f} deg" if turned_deg > 0.5 else "")


# --- the table -----------------------------------------------------------------------------------------


def _show(scene: Believed, truth: m.SimTruthReply | None, out: Path, json: bool) -> None:
    if json:
        emit_json(as_json(scene, out))
        return
    arms = table("arm", "tcp x y z (cm)", "roll pitch yaw (deg)", "hand (cm)>", "holds", "moves")
    for arm in scene.arms:
        arms.add_row(*_arm_cells(arm))
    console.print(arms)
    console.print()
    columns = ["object", "x y z (cm)", "roll pitch yaw (deg)", "in", "validity"]
    objects = table(*columns, *(["off by (mm)>", "turned (deg)>"] if truth else []))
    for row in scene.objects:
        validity = Text(row.validity.value, style=COLOUR.get(row.validity, ""))
        cells: list[str | Text] = [row.name, centimetres(row.pose), degrees(row.pose), row.where or "-", validity]
        if truth:
            style = "bold yellow" if differs(row) else ""
            cells.append(Text(f"{1e3 * (row.off_m or 0.0):.1f}", style=style))
            cells.append(Text(f"{math.degrees(row.turned_rad or 0.0):.1f}", style=style))
        objects.add_row(*cells)
    console.print(objects)
    console.print()
    console.print(Text(f"picture: {out}"))


def _arm_cells(arm: ArmRow) -> list[str]:
    where = [centimetres(arm.tcp), degrees(arm.tcp)] if arm.tcp else ["not known", ""]
    holds = arm.holding or "-"
    if arm.truly_holding is not None and arm.truly_holding != [arm.holding][: len(arm.holding)]:
        holds += f" (truly {', '.join(arm.truly_holding) or 'nothing'})"
    return [arm.name, *where, f"{100 * arm.hand_width_m:.2f}", holds, command_of(arm.moving) or "-"]


def as_json(scene: Believed, out: Path) -> dict[str, Any]:
    """SI units: m, rad, poses as [x y z qx qy qz qw]."""
    return {
        "file": str(out),
        "arms": [{**msgspec.to_builtins(arm), "joints": scene.scene.joints[arm.name]} for arm in scene.arms],
        "objects": msgspec.to_builtins(scene.objects),
    }
