"""rtc operator: what the operator is asked to do, with its picture, and the answer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.output import EXIT, AsJson, RunDir, With, cli_error, console, emit_json
from rtc.client.client import Client
from rtc.drawing.renderer import ASKED_NICENESS, Renderer
from rtc.drawing.scene import CameraPicture, Picture, believed, request_camera, true_scene
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import ArmSample, SimTruthReply, SurrenderRow, TeleopState
from rtc.protocol.outcomes import OutcomeKind, TimedOut
from rtc.protocol.units import in_words
from rtc.wording.advice import in_one_line

MEASURED_S = 1.0  # maximum wait for a telemetry sample
ROUND_TRIPS = 6  # over tcp in addition: those of a handshake


def operator(
    done: Annotated[bool, typer.Option("--done", help="You have done it: the same as the sentence DONE.")] = False,
    cannot: Annotated[str, typer.Option("--cannot", help="You cannot do it, for this reason.")] = "",
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Write the picture of the request to this PNG or JPEG file.")
    ] = None,
    run_dir: RunDir = None,
    key: With = None,
    json: AsJson = False,
) -> None:
    """Show what the operator is asked to do with each arm, or answer it. `rtc jog` moves the arm.

    DONE is believed only when the measurements prove it; otherwise the refusal states what is missing.

    The picture is that of the camera on the hand, else of the one that looks at it best. Without a camera, or without a
    simulator, the believed scene is drawn. With two requests there are two files: the name of the arm is added.

    Example:  rtc operator
    Example:  rtc operator --picture request.png
    Example:  rtc operator --done
    Example:  rtc operator --cannot "the bolt head is stripped"
    """
    if done and cannot:
        raise cli_error("one answer at a time: --done or --cannot", 2)
    if picture is not None and not (folder := picture.absolute().parent).is_dir():
        raise cli_error(f"there is no directory {folder} for the picture", 2)
    with Client(run_dir, key=key) as rtc:
        if done or cannot:
            _answer(rtc, "DONE" if done else f'CANNOT "{cannot.replace(chr(34), chr(39))}"')
        sample = next(rtc.telemetry(silence_s=MEASURED_S + ROUND_TRIPS * rtc.round_trip_s), None)
        arms = sample.arms if sample else {}
        asked = {name: arm for name, arm in arms.items() if arm.operation is not None}
        files = {} if picture is None else _pictures(rtc, list(asked), arms, picture)
        if json:
            emit_json(asked)
            return
        for name, arm in asked.items():
            _show(name, arm)
            if name in files:
                console.print(Text(f"  picture: {files[name]}"))
        surrendered = rtc.status().surrenders
        for one in surrendered:
            _offer(one)
        if not asked and not surrendered:
            console.print("the operator is asked for nothing now")


def _answer(rtc: Client, sentence: str) -> None:
    outcome = rtc.run(sentence).outcome
    if outcome.kind is not OutcomeKind.SUCCEEDED:
        clears = f" ({in_one_line(outcome.refusal.clears)})" if outcome.refusal is not None else ""
        raise cli_error(outcome.message + clears, EXIT[outcome.kind])
    console.print(outcome.message)


def _show(name: str, arm: ArmSample) -> None:
    operation = arm.operation
    assert operation is not None
    granted = [name, *(part for part, has in (("hand", operation.hand), ("spindle", operation.spindle)) if has)]
    console.print(f"{arm.primitive}: {operation.request}")
    console.print(f"  yours: {', '.join(granted)}{_distance(operation)}")
    force_n = sum(x * x for x in arm.wrench[:3]) ** 0.5
    console.print(f"  force {force_n:.1f} N, hand {in_words(round(arm.hand_width_m, 4), 'm')} open")
    for words in filter(None, (operation.operator and f"moved by {operation.operator}", operation.cut)):
        console.print(f"  {words}")


def _pictures(rtc: Client, asked: list[str], arms: dict[str, ArmSample], file: Path) -> dict[str, str]:
    """Write the picture of each request. Returns, by arm, its file and what it shows. Raises RtcError."""
    made, cell = dict[str, str](), Cell.load(rtc.settings.cell)
    with Renderer(ASKED_NICENESS) as renderer:
        for name in asked:
            one = file if len(asked) == 1 else file.with_stem(f"{file.stem}-{name}")
            out, camera = str(one.absolute()), request_camera(cell.cameras, name, arms[name])
            if camera and (truth := _truth(rtc)) is not None:
                renderer.draw(CameraPicture(out=out, cell=rtc.settings.cell, camera=camera, scene=true_scene(truth)))
                made[name] = f"{one}, by {camera}"
                continue
            facts = {fact.key: fact for fact in rtc.world.view().facts}
            panel = believed(cell, facts, arms, None).panel
            renderer.draw(Picture(out=out, cell=rtc.settings.cell, panels=[panel], camera=name))
            made[name] = f"{one}, of the believed scene"
    return made


def _truth(rtc: Client) -> SimTruthReply | None:
    try:
        return rtc.truth()
    except TimedOut:  # real arms: no pictures of simulated cameras
        return None


def _offer(surrendered: SurrenderRow) -> None:
    """A command that has failed, and that the operator may do instead."""
    console.print(f"{surrendered.command} has failed: {surrendered.cause}")
    if waiting := ", ".join(surrendered.waiting):
        console.print(f"  held until you have done it, or RESUME: {waiting}")
    console.print(f"  to do it: {surrendered.sentence}")


def _distance(operation: TeleopState) -> str:
    if operation.off_m is None:
        return ""
    near = f"; {in_words(operation.done_m, 'm')} is near enough" if operation.done_m is not None else ""
    return f"; {in_words(round(operation.off_m, 3), 'm')} from the goal{near}"
