"""rtc world save, restore, diff: facts in a file, back from it, and what differs between two states of the world."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from json import loads
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json, exit_code, table
from rtc.apps.cli.progress import print_result
from rtc.apps.cli.world import COLOUR, app, at_version, joint_units, refuse_live
from rtc.client.client import Client
from rtc.protocol import wire
from rtc.protocol.messages import Fact, SavedFact, SavedWorld, SimTruthReply, Validity, View
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import geometry
from rtc.wording.facts import JointUnits, stated
from rtc.world.model import location

RESTORE = "SET WORLD FACTS SAVED"
POSES = ("frame", "grasp")
SAME_M, SAME_RAD = 1e-6, 1e-6  # poses that differ by less are the same
TRUE_M, TRUE_RAD = 1e-3, 2e-3  # the same beside the truth, which is never met exactly
TRUTH = "truth"

Facts = Mapping[str, SavedFact]


class FactDifference(NamedTuple):
    """One fact in two states of the world; None: it is in one of them only. Of a pose also how far they differ."""

    key: str
    before: SavedFact | None
    after: SavedFact | None
    off_m: float | None = None
    turned_rad: float | None = None


@app.command()
def save(
    file: Annotated[Path, typer.Argument(help="The file to write, such as before.json.")],
    json: AsJson = False,
    run_dir: RunDir = None,
    key_file: With = None,
) -> None:
    """Save all facts with validity and spread, for `rtc world diff` and `rtc world restore`.

    Facts that an arm in motion changes are saved as suspect, with their values before the motion.

    Example:  rtc world save before.json
    """
    with Client(run_dir, key=key_file) as rtc:
        view, cell = rtc.world.view(), rtc.status().programs["cell"]
    saved = SavedWorld(cell=cell, facts=as_saved(view.facts))
    try:
        file.write_bytes(msgspec.json.format(msgspec.json.encode(saved)) + b"\n")
    except OSError as error:
        raise cli_error(f"{file} cannot be written: {error}") from None
    if json:
        emit_json({"file": str(file), "version": view.version, "facts": len(saved.facts)})
    else:
        console.print(Text(f"{file}: {len(saved.facts)} facts, version {view.version} of the world"))


@app.command()
def restore(
    file: Annotated[Path, typer.Argument(help="A file of `rtc world save`.")],
    json: AsJson = False,
    run_dir: RunDir = None,
) -> None:
    """Put the facts of objects, seats and taught places back to those of a file. No body is moved.

    It is the sentence SET WORLD FACTS SAVED: an analyzer checks and writes the facts. Joints and hands keep theirs,
    because they are measured; the place of what was in a hand then becomes suspect. Refused while a command is in
    progress or a hand holds something, and for a file of another cell.

    Example:  rtc world restore before.json
    """
    saved = load(file)
    with Client(run_dir) as client:
        status = client.status()
        refuse_live(status)
        if saved.cell != status.programs["cell"]:
            raise cli_error(f"{file} is about another cell than that of this cluster, or another version of it", 2)
        ended = client.submit(RESTORE, saved=saved).wait()
    if ended.outcome.kind is not OutcomeKind.SUCCEEDED:
        print_result(ended, RESTORE, console)
        raise typer.Exit(exit_code([ended.outcome.kind]))
    if json:
        emit_json({"command": ended.command, "file": str(file), "moved": []})
    else:
        console.print(Text(f"the facts are those of {file} again ({ended.command}); no body was moved"))


@app.command()
def diff(
    before: Annotated[str, typer.Argument(help="A version of the world, a file of `rtc world save`, or: truth.")],
    after: Annotated[str, typer.Argument(help="The same.", show_default="the world now")] = "",
    json: AsJson = False,
    run_dir: RunDir = None,
    key_file: With = None,
) -> None:
    """Show the facts that differ between two states of the world; of poses also by how much.

    With `truth` the facts are compared with the simulator: differences up to 1 mm and 0.1 deg are left out.

    Example:  rtc world diff before.json
    Example:  rtc world diff 42 57
    Example:  rtc world diff truth
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        now = rtc.world.view()
        states = [_state(rtc, name, now) for name in (before, after)]
        units = joint_units(rtc)
    if TRUTH in (before, after):
        known = set(states[0]) & set(states[1])  # the simulator has no facts of belief
        states = [{key: state[key] for key in state if key in known} for state in states]
        found = [one for one in differences(*states) if beyond(one, TRUE_M, TRUE_RAD)]
    else:
        found = differences(*states)
    if json:
        emit_json({"version": now.version, "differences": [as_row(one) for one in found]})
    else:
        print_differences(found, units)


def _state(rtc: Client, name: str, now: View) -> Facts:
    """The facts at a version, of a file, of the simulator, or now. Raises typer.Exit with the reason printed."""
    if not name:
        return as_saved(now.facts)
    if name.lower() == TRUTH:
        return of_truth(rtc.truth())
    if name.isdigit():
        return as_saved(at_version(rtc, int(name), now).values())
    return load(Path(name)).facts


def load(file: Path) -> SavedWorld:
    """Raises typer.Exit with the reason printed."""
    try:
        text = file.read_bytes()
        saved = msgspec.json.decode(text, type=SavedWorld)
        loads(text, object_pairs_hook=_once)  # of equal keys the decoder takes the last one
        wire.encode(saved)  # its numbers may be too large for a message
        return saved
    except (OSError, ValueError, OverflowError) as error:
        raise cli_error(f"{file} is no file of `rtc world save`: {error}", 2) from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Raises ValueError for a key that is given twice."""
    keys = Counter(key for key, _ in pairs)
    if twice := [key for key, n in keys.items() if n > 1]:
        raise ValueError(f"{twice[0]} is given twice")
    return dict(pairs)


def as_saved(facts: Iterable[Fact]) -> dict[str, SavedFact]:
    doubt = {Validity.CHANGING: Validity.SUSPECT}
    return {
        fact.key: SavedFact(value=fact.value, validity=doubt.get(fact.validity, fact.validity), spread=fact.spread)
        for fact in sorted(facts, key=lambda fact: fact.key)
    }


def of_truth(truth: SimTruthReply) -> dict[str, SavedFact]:
    """What the simulator knows of the same facts."""
    poses = {**truth.poses, **truth.seats}
    values: dict[str, Any] = {f"{name}.frame": pose for name, pose in poses.items()}
    values |= {f"{arm}.joints": joints for arm, joints in truth.joints.items()}
    values |= {f"{arm}.hand_width": sum(fingers) for arm, fingers in truth.fingers.items()}
    values |= {f"{arm}.holding": next(iter(held), "") for arm, held in truth.held.items()}
    return {key: SavedFact(value=value) for key, value in values.items()}


def differences(before: Facts, after: Facts) -> list[FactDifference]:
    """The facts that differ, in the order of their keys."""
    found = []
    for key in sorted({*before, *after}):
        old, new = before.get(key), after.get(key)
        if old is None or new is None:
            found.append(FactDifference(key, old, new))
        elif _is_pose(key, old, new):
            off_m, turned_rad = geometry.distance(old.value, new.value), geometry.angle(old.value, new.value)
            one = FactDifference(key, old, new, off_m, turned_rad)
            if old.validity is not new.validity or beyond(one, SAME_M, SAME_RAD):
                found.append(one)
        elif (old.value, old.validity) != (new.value, new.validity):
            found.append(FactDifference(key, old, new))
    return found


def beyond(one: FactDifference, within_m: float, within_rad: float) -> bool:
    """Whether the values differ by more than this. Lengths and joints are compared as poses are."""
    if one.off_m is not None and one.turned_rad is not None:
        return one.off_m > within_m or one.turned_rad > within_rad
    if one.before is None or one.after is None:
        return True
    pairs = _figures(one.before.value), _figures(one.after.value)
    within = within_m if one.key.endswith(".hand_width") else within_rad
    if None in pairs or len(pairs[0] or ()) != len(pairs[1] or ()):
        return bool(one.before.value != one.after.value)
    return any(abs(a - b) > within for a, b in zip(pairs[0] or (), pairs[1] or (), strict=True))


def _figures(value: Any) -> list[float] | None:
    values = value if isinstance(value, list) else [value]
    return values if all(isinstance(n, float | int) and not isinstance(n, bool) for n in values) else None


def _is_pose(key: str, *facts: SavedFact) -> bool:
    return key.rpartition(".")[2] in POSES and all(isinstance(fact.value, list) for fact in facts)


def as_row(one: FactDifference) -> dict[str, Any]:
    """For --json: m and rad."""
    row = {"key": one.key, "location": location(one.key), "before": one.before, "after": one.after}
    figures = {"off_m": one.off_m, "turned_rad": one.turned_rad}
    return row | {name: value for name, value in figures.items() if value is not None}


def print_differences(found: list[FactDifference], units: JointUnits) -> None:
    if not found:
        console.print("no fact differs")
        return
    out = table("fact", "before", "after", "differs by")
    for one in found:
        by = "" if one.off_m is None else f"{1e3 * one.off_m:.1f} mm, {math.degrees(one.turned_rad or 0.0):.2f} deg"
        out.add_row(one.key, _shown(one.key, one.before, units), _shown(one.key, one.after, units), by)
    console.print(out)
    console.print("1 fact differs" if len(found) == 1 else f"{len(found)} facts differ")


def _shown(key: str, fact: SavedFact | None, units: JointUnits) -> Text:
    if fact is None:
        return Text("(no such fact)", style="dim")
    known = Fact(key=key, value=fact.value, validity=fact.validity, version=0, source="", at_s=0.0, spread=fact.spread)
    words = Text(stated(known, units))
    return (
        words if fact.validity is Validity.VALID else words.append(f" {fact.validity}", COLOUR.get(fact.validity, ""))
    )
