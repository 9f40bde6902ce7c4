"""rtc cell: check a cell, URDF or SRDF and draw it; write the first cell for an arm. They need no cluster."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, cli_error, console, emit_json, table
from rtc.drawing.renderer import ASKED_NICENESS, Renderer
from rtc.drawing.scene import VIEWS, Panel, Picture, SceneView
from rtc.language.hands import hand_in_words
from rtc.model.cells.cell import CELLS, Cell
from rtc.protocol.outcomes import RtcError

if TYPE_CHECKING:
    from rtc.apps.authoring.draft import Draft

app = typer.Typer(no_args_is_help=True, help="Check and draw a work-cell; write the first one for an arm of your own.")


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="A cell (.yaml, or a name such as swapout), URDF or SRDF file.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Draw the cell or arm: the PNG file to write.", show_default="none"),
    ] = None,
    camera: Annotated[str, typer.Option(help=f"With -o: {', '.join(VIEWS)}; or an arm, object, seat.")] = "overview",
    json: AsJson = False,
) -> None:
    """All faults of a cell with its robot models, or of one URDF or SRDF: where, what, and what was expected.

    Errors keep `rtc up` or a motion from working; warnings are probable mistakes. First it checks the file: fields,
    references, joints, links, limits, inertias, meshes, the SRDF. Then it checks home, stow, places, grasp points and
    seats, with inverse kinematics, collisions and weight. Exit status 1 with an error.

    Example:  rtc cell check cell.yaml -o cell.png
    Example:  rtc cell check arm.urdf -o arm.png
    """
    from rtc.apps.authoring.review import review  # imports kinematics, which takes 0.3 s

    path = _file(file)
    findings, cell = review(path)
    errors = sum(one.severity == "error" for one in findings)
    why = "" if out is None else _why_not_drawn(path, cell, errors, out, camera)
    drawn = str(out) if out is not None and not why else ""
    if json:
        emit_json({"file": str(path), "errors": errors, "findings": msgspec.to_builtins(findings), "picture": drawn})
    else:
        rows = table("line>", "where", "what is wrong", "expected")
        for one in findings:
            style = "red" if one.severity == "error" else "yellow"
            name = "" if one.file == str(path) else f"{Path(one.file).name}: "
            rows.add_row(
                str(one.line or ""), Text(name + one.where, style=style), Text(one.problem), Text(one.expected)
            )
        if findings:
            console.print(rows)
        console.print(Text(f"{path}: {_count(errors, 'error')}, {_count(len(findings) - errors, 'warning')}"))
        if out is not None:
            console.print(Text(f"no picture: {why}" if why else f"picture: {drawn}"))
    if errors:
        raise typer.Exit(1)


@app.command()
def new(
    urdf: Annotated[Path, typer.Option(help="The URDF of the arm, as it comes; meshes beside it.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The cell file; its models are beside it.", show_default="NAME/cell.yaml"),
    ] = None,
    name: Annotated[
        str, typer.Option(help="Name of the arm in sentences, such as MY-ARM.", show_default="the robot's name")
    ] = "",
    tip: Annotated[
        str, typer.Option(help="Link after which the arm ends: what is beyond is replaced by a parallel hand.")
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    json: AsJson = False,
) -> None:
    """Write the first cell for an arm that rtc does not know, from its URDF.

    The arm keeps its parallel gripper, or gets one with a wrist sensor. Meshes become convex hulls; the grasp frame,
    pairs of links without a collision check, home, stow, accelerations and payload are computed. The cell has gravity,
    a floor, two pads and a cube. Its first lines state what was changed or assumed.

    Example:  rtc cell new --urdf panda.urdf --name PANDA -o mycell/cell.yaml
    """
    from rtc.apps.authoring.draft import draft

    made = draft(urdf, name.upper().replace("_", "-"), tip)
    file = out or Path(made.cell.name) / "cell.yaml"
    if file.suffix not in (".yaml", ".yml"):
        raise cli_error(f"-o names a cell file, such as {file / 'cell.yaml'}", 2)
    files = _files(made, file)
    there = [str(one) for one in files if one.exists()]
    if there and not force:
        raise cli_error(f"{there[0]} exists{f' and {len(there) - 1} more files' if there[1:] else ''}: use --force", 2)
    _write(files)
    arm = made.cell.arms[0].name
    if json:
        emit_json({"file": str(file), "arm": arm, "files": [str(one) for one in files], "notes": made.notes})
        return
    for note in made.notes:
        console.print(Text(f"- {note}"))
    console.print(Text(f"{file}: the arm is {arm}. Next:"))
    console.print(Text(f"  rtc cell check {file} -o cell.png --camera left"))
    console.print(Text(f"  rtc up -d --cell {file}"))
    console.print(Text(f'  rtc do "STOW {hand_in_words(arm)}"'))


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _files(made: Draft, file: Path) -> dict[Path, str]:
    """The files of a first cell with their texts. `file`: the cell file."""
    return {file: made.yaml, **{file.parent / one: text for one, text in made.files.items()}}


def _write(files: dict[Path, str]) -> None:
    for one, text in files.items():
        one.parent.mkdir(parents=True, exist_ok=True)
        one.write_text(text, encoding="utf-8")


def _why_not_drawn(path: Path, cell: Cell | None, errors: int, out: Path, camera: str) -> str:
    """As `_draw_checked`, with the reason if the renderer is late or has ended: the findings are there all the same."""
    try:
        return _draw_checked(path, cell, errors, out, camera)
    except RtcError as error:
        return str(error)


def _draw_checked(path: Path, cell: Cell | None, errors: int, out: Path, camera: str) -> str:
    """Draw the cell, or the first cell of the arm of a URDF or SRDF. Returns why there is no picture, or ''."""
    if cell is not None:
        draw(path, cell, out, camera)
        return ""
    if errors:
        return "it cannot be built before its errors are corrected"
    from rtc.apps.authoring.draft import draft

    with TemporaryDirectory(prefix="rtc-cell-") as folder:
        file = Path(folder) / "cell.yaml"
        try:
            made = draft(path.with_suffix(".urdf"))
        except RtcError as error:
            return str(error)
        _write(_files(made, file))
        draw(file, made.cell, out, camera)
    return ""


def draw(path: Path, cell: Cell, out: Path, camera: str) -> None:
    """A picture of the cell as it begins, with the names of its things. Raises RtcError."""
    if not out.absolute().parent.is_dir():
        raise cli_error(f"there is no directory {out.absolute().parent} for the picture", 2)
    poses = {thing.name: cell.object_pose(thing.name).tolist() for thing in cell.objects}
    scene = SceneView(
        poses=poses,
        joints={arm.name: arm.home_rad for arm in cell.arms},
        seats={seat.name: seat.frame.pose.tolist() for seat in cell.seats},
    )
    labels = {arm.name: arm.name for arm in cell.arms}
    labels |= {thing.name: thing.name for thing in cell.objects if not thing.fixed}
    view = camera.lower() if camera.lower() in VIEWS else camera.upper().replace("_", "-")
    with Renderer(ASKED_NICENESS) as renderer:
        panel = Panel(title=f"{cell.name}: all arms at home", scene=scene, labels=labels)
        renderer.draw(Picture(out=str(out.absolute()), cell=str(path.absolute()), panels=[panel], camera=view))


def _file(given: Path) -> Path:
    """The file of a cell that comes with rtc, by its name; else the path itself."""
    known = CELLS / given / "cell.yaml"
    return known if not given.exists() and known.is_file() else given / "cell.yaml" if given.is_dir() else given
