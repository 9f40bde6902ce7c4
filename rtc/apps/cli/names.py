"""rtc names: every name that a sentence may use in a cell, by kind. It reads the cell and needs no cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, NamedTuple

import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_of
from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, emit_json, table
from rtc.apps.cli.teach import with_taught
from rtc.language.hands import hand_in_words
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera, Object, Place, Region, Seat
from rtc.protocol.sentence import BOTH_ARMS
from rtc.protocol.spelling import unknown
from rtc.spatial.axis_names import AXES

NO_GRASP = "GRASP needs a row of command_object_table for it"  # of an object of a kind that the programs do not know
OTHER_WORDS = {"axis": "axes", "hand": "arms", "hands": "arms", "end-effector": "arms", "end-effectors": "arms"}


class NameEntry(NamedTuple):
    """One name. `also`: other names of the same thing; `about`: its description for people (cm, deg)."""

    name: str
    about: str
    also: tuple[str, ...] = ()


def names(
    kind: Annotated[
        str,
        typer.Argument(help="One kind only, such as places.", show_default="all", autocompletion=lambda: list(KINDS)),
    ] = "",
    cell: Annotated[
        str, typer.Option(help="Name of a cell that comes with rtc, or a cell file.", show_default="the cluster's")
    ] = "",
    json: AsJson = False,
    run_dir: RunDir = None,
) -> None:
    """The names a sentence may use: arms, objects, grasp points, seats, places, regions, attitudes, cameras, axes.

    They come from the running cluster's cell; without a cluster, from the cell `swapout`.

    Example:  rtc names places
    """
    wanted = kind_of(kind)
    what = cell or cell_of(run_dir)
    known = Cell.load(what) if cell else with_taught(Cell.load(what), run_dir)
    if json:
        found = _found(known, wanted)
        emit_json({"cell": what, "names": {kind: [row._asdict() for row in rows] for kind, rows in found.items()}})
        return
    print_names(what, known, wanted)


def _found(cell: Cell, kind: str) -> dict[str, list[NameEntry]]:
    return {name: rows(cell) for name, (rows, _) in KINDS.items() if kind in ("", name)}


def print_names(title: str, known: Cell, kind: str) -> None:
    """`kind`: a row of KINDS; empty: all."""
    console.print(Text(f"cell {title}"))
    for name, rows in _found(known, kind).items():
        console.print()
        console.print(Text(name, style="bold") + Text(f"   such as: {KINDS[name][1](known)}", style="dim"))
        out = table("", "", "")
        out.show_header = False
        for row in rows:
            also = f"also {', '.join(row.also)}" if row.also else ""
            out.add_row(Text("  " + row.name), Text(row.about), Text(also, style="dim"))
        console.print(out if rows else Text("  there are none"))


def kind_of(word: str) -> str:
    """The row of KINDS for a typed word, plural or singular, in any case. Raises typer.Exit."""
    kind = word.lower().replace("_", "-").replace(" ", "-")
    kind = OTHER_WORDS.get(kind, kind)
    match = next((name for name in KINDS if kind in (name, name.removesuffix("s"))), "")
    if word and not match:
        raise cli_error(unknown("kind", kind, KINDS), 2)
    return match


def _arms(cell: Cell) -> list[NameEntry]:
    found = [
        NameEntry(
            arm.name,
            f"{len(arm.joints)} joints, hand opens to {_cm(arm.gripper.max_opening_m)} cm",
            (arm.end_effector,),
        )
        for arm in cell.arms
    ]
    both = NameEntry(BOTH_ARMS, "in HALT; in MOVE, LIFT and CARRY with one object in both hands")
    return [*found, both] if len(found) > 1 else found


def _objects(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(
            thing.name,
            f"{thing.kind}, " + ("fixed, cannot be grasped" if thing.fixed else f"{thing.mass_kg:g} kg")
            + (f", begins in {thing.seat}" if thing.seat else "")
            + ("" if thing.fixed or _can_be_grasped(thing) else f", {NO_GRASP}"),
        )
        for thing in cell.objects
    ]  # fmt: skip


def _grasp_points(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(
            point.name,
            f"of {thing.name}, {_cm(point.width_m)} cm wide" + ("" if _can_be_grasped(thing) else f", {NO_GRASP}"),
        )
        for thing in cell.objects
        for point in thing.grasp_points
    ]


def _can_be_grasped(thing: Object) -> bool:
    """Whether the programs that come with rtc have figures to GRASP it."""
    return thing.kind in _graspable() or thing.name in _graspable()


@cache
def _graspable() -> frozenset[str]:
    """Kinds and names of objects in the rows of GRASP."""
    from rtc.programs.loader import decode, default
    from rtc.programs.schema import ElaboratorProgram

    rows = decode(default("elaborator"), ElaboratorProgram).command_object_table
    return frozenset(row.name or row.kind for row in rows if row.verb == "GRASP")


def _seats(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(seat.name, f"{seat.kind}, a module in it is at {_xyz(cell.seated_pose(seat.name)[:3].tolist())}")
        for seat in cell.seats
    ]


def _places(cell: Cell) -> list[NameEntry]:
    found = []
    for place in cell.places:
        at = [f"{arm} at {_xyz(frame.xyz)}" for arm, frame in place.poses.items()]
        at += [f"{arm} by joints" for arm in place.joints_deg]
        found.append(NameEntry(place.name, "; ".join(at)))
    return found


def _regions(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(r.name, f"box of {' x '.join(_cm(n) for n in r.size_m)} cm about {_xyz(r.frame.xyz)}")
        for r in cell.regions
    ]


def _attitudes(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(name, "roll pitch yaw {:g} {:g} {:g} deg".format(*frame.rpy_deg))
        for name, frame in cell.attitudes.items()
    ]


def _cameras(cell: Cell) -> list[NameEntry]:
    return [
        NameEntry(
            camera.name,
            (f"on {camera.arm}" if camera.arm else f"at {_xyz(camera.xyz)}, looks at {_xyz(camera.looks_at)}")
            + f", {camera.size_px[0]} x {camera.size_px[1]} pixels",
        )
        for camera in cell.cameras
    ]


def _axes(_: Cell) -> list[NameEntry]:
    same: dict[tuple[str, tuple[float, ...]], list[str]] = {}
    for name, axis in AXES.items():
        same.setdefault(axis, []).append(name)
    return [
        NameEntry(first, f"{whose} axis {' '.join(f'{n:g}' for n in vector)}", tuple(others))
        for (whose, vector), (first, *others) in same.items()
    ]


def _cm(metres: float) -> str:
    return f"{round(100 * metres, 2) + 0.0:g}"


def _xyz(point: tuple[float, ...] | list[float]) -> str:
    return " ".join(map(_cm, point)) + " cm"


def _arm(cell: Cell) -> str:
    """The first arm as a sentence names it."""
    return hand_in_words(cell.arms[0].name)


def _thing(cell: Cell) -> str:
    return next((thing.name for thing in cell.objects if thing.grasp_points and _can_be_grasped(thing)), "OBJECT")


def _point(cell: Cell) -> str:
    return next(
        (point.name for thing in cell.objects if _can_be_grasped(thing) for point in thing.grasp_points), "POINT"
    )


def _first(parts: Sequence[Camera | Place | Seat | Region], otherwise: str) -> str:
    return parts[0].name if parts else otherwise


def _racks(cell: Cell) -> list[Seat]:
    """The seats that PLACE fills: a socket is filled by MATE."""
    return [seat for seat in cell.seats if seat.mating is None]


#: kind -> function that reads it from a cell, and an example sentence for that cell
KINDS: dict[str, tuple[Callable[[Cell], list[NameEntry]], Callable[[Cell], str]]] = {
    "arms": (_arms, lambda cell: f"STOW {_arm(cell)}"),
    "objects": (_objects, lambda cell: f"GRASP {_thing(cell)} WITH {_arm(cell)}"),
    "grasp-points": (_grasp_points, lambda cell: f"GRASP {_thing(cell)} {_point(cell)} WITH {_arm(cell)}"),
    "seats": (_seats, lambda cell: f"PLACE {_thing(cell)} ON {_first(_racks(cell), 'SEAT')}"),
    "places": (_places, lambda cell: f"MOVE {_arm(cell)} TO {_first(cell.places, 'PLACE')}"),
    "regions": (
        _regions,
        lambda cell: f"STOW {_arm(cell)} MAINTAIN AVOID-TASK-REGION {_first(cell.regions, 'REGION')}",
    ),
    "attitudes": (
        _attitudes,
        lambda cell: f"LIFT {_thing(cell)} MAINTAIN POSE-DURING-MOTION {next(iter(cell.attitudes), 'ATTITUDE')}",
    ),
    "cameras": (_cameras, lambda cell: f"LOCATE {_thing(cell)} VIA {_first(cell.cameras, 'CAMERA')}"),
    "axes": (_axes, lambda cell: f"MOVE {_arm(cell)} BY 5 CM ALONG UP"),
}
