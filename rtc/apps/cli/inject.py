"""rtc inject: inject faults into the simulated arms, sensors and cameras of the running cluster, and undo them.

It uses the bench socket of the simulator, which is not reachable over TCP: only the owner of the run directory can.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, duration_s, emit_json
from rtc.client.client import Client
from rtc.protocol import faults as f
from rtc.protocol.messages import SimDone
from rtc.protocol.outcomes import RtcError, StopReason, TimedOut

app = typer.Typer(
    help="Inject faults into the simulation; undo them. rtc status shows the active ones. They end with its process.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
Arm = Annotated[str, typer.Argument(help="An arm, by its name: rtc names arms.")]


@app.command()
def displace(
    object: Annotated[
        str,
        typer.Argument(help="An object of the cell, with its seat or what is mounted on it; or a seat that is empty."),
    ],
    by: Annotated[str, typer.Option(help="X,Y,Z in metres, world axes.")] = "0,0,0",
    turn: Annotated[str, typer.Option(help="ROLL,PITCH,YAW in degrees, world axes, about the object.")] = "0,0,0",
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Move an object in the simulation only, so that the world database is wrong. Refused while a hand holds it.

    Undo returns it, unless an arm has moved it since.

    Example:  rtc inject displace MACS-NEW --by 0,0.02,0 --turn 0,0,3
    """
    _inject(f.Displaced(object=_name(object), offset=_by_and_turn(by, turn)), run_dir, json)


@app.command()
def drift(
    object: Annotated[
        str, typer.Argument(help="An object of the cell; its seat and what is mounted on it move with it.")
    ],
    by: Annotated[str, typer.Option(help="X,Y,Z in metres per second, world axes.")] = "0,0,0",
    turn: Annotated[str, typer.Option(help="X,Y,Z in degrees per second, world axes, about the object.")] = "0,0,0",
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Make an object move by itself at a constant velocity, such as a turning satellite. In a hand it rests.

    It passes through other bodies and pushes none of them. After undo it stays where it is.

    Example:  rtc inject drift SATELLITE --turn 1,0,0
    """
    _inject(f.Drifting(object=_name(object), velocity=_by_and_turn(by, turn)), run_dir, json)


@app.command()
def stick(
    arm: Arm,
    joint: Annotated[str, typer.Argument(help="A joint of its URDF, such as joint_3.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Lock a joint of an arm. A motion of it ends with the reason following_error.

    Example:  rtc inject stick RIGHT-ARM joint_3
    """
    _inject(f.StuckJoint(arm=_name(arm), joint=joint), run_dir, json)


@app.command()
def sensor(
    arm: Arm,
    offset: Annotated[
        str, typer.Option(help="FX,FY,FZ[,TX,TY,TZ] in N and N.m, tool axes, added to each reading.")
    ] = "",
    freeze: Annotated[bool, typer.Option("--freeze", help="The wrist sensor repeats its present reading.")] = False,
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Falsify the wrist sensor of an arm: add an offset to its readings, or freeze them.

    An offset that exists before a motion begins has no effect on it: each motion measures from its start.

    Example:  rtc inject sensor RIGHT-ARM --offset 0,0,30
    Example:  rtc inject sensor RIGHT-ARM --freeze
    """
    if bool(offset) is freeze:
        raise cli_error("state either --offset or --freeze", 2)
    wrench = None
    if offset:
        wrench = _figures(offset, 6 if offset.count(",") > 2 else 3, "--offset")
        wrench += [0.0] * (6 - len(wrench))
    _inject(f.FalseSensor(arm=_name(arm), offset=wrench), run_dir, json)


@app.command()
def jam(
    seat: Annotated[str, typer.Argument(help="A seat of the cell, such as BAY-2.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Jam a seat. A module in it is stuck; a module that is inserted is wedged 4 cm before its place.

    Example:  rtc inject jam BAY-2
    """
    _inject(f.JammedSeat(seat=_name(seat)), run_dir, json)


@app.command()
def blunt(
    seat: Annotated[str, typer.Argument(help="A seat of the cell that has lips, such as BAY-2.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Take away the lips of a seat: they guide no module in any more.

    Refused with exact arms.

    Example:  rtc inject blunt BAY-2
    """
    _inject(f.BluntSeat(seat=_name(seat)), run_dir, json)


@app.command()
def strip(
    bolt: Annotated[str, typer.Argument(help="A bolt of the cell.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Strip the thread of a bolt: it turns without coming out or going in.

    Refused in a cell without bolts, and with exact arms.

    Example:  rtc inject strip BOLT-1
    """
    _inject(f.StrippedBolt(bolt=_name(bolt)), run_dir, json)


@app.command()
def drop(arm: Arm, run_dir: RunDir = None, json: AsJson = False) -> None:
    """Make the hand of an arm fail: it opens, drops the object, and obeys no command until this is undone.

    Refused if it holds no object.

    Example:  rtc inject drop RIGHT-ARM
    """
    _inject(f.FailedHand(arm=_name(arm)), run_dir, json)


@app.command()
def misread(arm: Arm, run_dir: RunDir = None, json: AsJson = False) -> None:
    """Make a hand that closes on something read as closed on nothing, until it opens. This happens once.

    Example:  rtc inject misread RIGHT-ARM
    """
    _inject(f.MisreadHand(arm=_name(arm)), run_dir, json)


@app.command()
def weaken(
    arm: Arm,
    by: Annotated[float, typer.Argument(help="Force that it loses in a second, N.", metavar="N")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Weaken the grip of an arm steadily. Each time it closes it has its force again, and then loses it.

    Example:  rtc inject weaken RIGHT-ARM 0.5
    """
    _inject(f.WeakHand(arm=_name(arm), n_s=by), run_dir, json)


@app.command()
def blind(
    camera: Annotated[str, typer.Argument(help="A camera of the cell, such as CAMERA-1.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Make the pictures of a camera black.

    Example:  rtc inject blind CAMERA-1
    """
    _inject(f.BlindCamera(camera=_name(camera)), run_dir, json)


@app.command()
def end(
    arm: Arm,
    reason: Annotated[StopReason, typer.Argument(help="The reason that its report states.", metavar="REASON")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Make the step that an arm executes, or its next one, end at once for a reason. This happens once.

    So a trim can be tried where nothing is wrong. With rtc break it meets the step that you want.

    Example:  rtc inject end RIGHT-ARM no_contact
    """
    _inject(f.ForcedEnd(arm=_name(arm), reason=reason), run_dir, json)


@app.command()
def slow(
    by: Annotated[str, typer.Argument(help="Time added to each tick of the servo loop: 0.1ms to 50ms.")],
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Slow the servo loop down. Above 1 ms ticks are late, and simulated time passes more slowly.

    Example:  rtc inject slow 3ms
    """
    _inject(f.SlowLoop(tick_s=duration_s(by, "the duration")), run_dir, json)


@app.command()
def undo(
    name: Annotated[
        list[str] | None,
        typer.Argument(help="A fault by its name, as rtc status shows it.", show_default="all"),
    ] = None,
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Undo one injected fault, or all.

    Example:  rtc inject undo
    Example:  rtc inject undo jam BAY-2
    """
    words = " ".join(name or ["all"])
    words = "ALL" if words.lower() == "all" else words
    _change(lambda rtc: rtc.undo_fault(words), run_dir, json)


def _inject(fault: f.AnyFault, run_dir: RunDir, json: bool) -> None:
    _change(lambda rtc: rtc.inject(fault), run_dir, json)


def _change(send: Callable[[Client], SimDone], run_dir: RunDir, json: bool) -> None:
    """Change the injected faults and show those that are active now."""
    with Client(run_dir, need_broker=False) as rtc:
        try:
            done = send(rtc)
        except TimedOut as error:
            raise RtcError("faults are injected into a simulation, and no subsystem of arms answers as one") from error
    if done.note:
        console.print(Text(done.note))
    console.print(Text("injected faults: ", style="bold") + Text("; ".join(done.active) or "none"))
    if json:
        emit_json({"active": done.active, "note": done.note})


def _name(text: str) -> str:
    """A name of the cell; case and `_` are ignored."""
    return text.upper().replace("_", "-")


def _by_and_turn(by: str, turn: str) -> list[float]:
    """Three lengths (m) and three angles (rad), not all 0."""
    values = [*_figures(by, 3, "--by"), *map(math.radians, _figures(turn, 3, "--turn"))]
    if not any(values):
        raise cli_error("state --by, --turn or both", 2)
    return values


def _figures(text: str, count: int, option: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise cli_error(f"{option} is {count} numbers with commas between them; not {text}", 2)
    return values
