"""rtc world: shows the facts of the world database with age, source and validity; `reset` alone changes some."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import nullcontext, suppress
from typing import Annotated, NoReturn

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.cluster_cell import cell_file, cell_of
from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json, exit_code, table
from rtc.apps.cli.progress import print_result
from rtc.client.client import Client
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import Fact, MotionRow, Status, Validity, View
from rtc.protocol.outcomes import OutcomeKind, RtcError
from rtc.protocol.spelling import unknown
from rtc.wording.facts import JointUnits, stated, units_in
from rtc.wording.measured import seconds
from rtc.world.client import WorldClient

BROKER_S = 1.0  # maximum wait for what the arms are doing; the facts are shown without a broker too
MOTION = ("primitive", "started_ago_s", "time_s", "positions", "velocities", "accelerations")
HISTORY = 1000  # maximum number of facts of one key that `at` searches
COLOUR = {
    Validity.VALID: "green",
    Validity.UNKNOWN: "magenta",
    Validity.SUSPECT: "bold yellow",
    Validity.INVALID: "red",
    Validity.CHANGING: "cyan",
}

RESET = "SET WORLD FACTS INITIAL"

Key = Annotated[str, typer.Argument(help="A fact (MACS-NEW.frame) or all of a location (MACS-NEW).")]

app = typer.Typer(
    help="The world database: facts with validity, version, source and age.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command("list")
def list_facts(json: AsJson = False, run_dir: RunDir = None, key_file: With = None) -> None:
    """Print all facts. Facts that a moving arm changes are shown as changing, with its path and the time since its
    start.

    Example:  rtc world list
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        view, motions, units = rtc.world.view(), _motions(rtc), joint_units(rtc)
    _show(with_motions(view.facts, motions, time.monotonic()), json, view.version, units)


@app.command()
def get(key: Key, json: AsJson = False, run_dir: RunDir = None, key_file: With = None) -> None:
    """Print one fact, or all of a location. Exit status 2 if there is none.

    Example:  rtc world get MACS-NEW.frame
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        view, motions, units = rtc.world.view(keys=[spelt(key)]), [] if "." in key else _motions(rtc), joint_units(rtc)
        if not view.facts:
            raise _unknown(key, rtc.world)
    _show(with_motions(view.facts, motions, time.monotonic()), json, view.version, units)


@app.command()
def watch(
    key: Annotated[str, typer.Argument(help="A fact or a location; without it, everything.")] = "",
    every: Annotated[float, typer.Option(min=0.02, max=3600, help="Seconds between two looks.")] = 0.2,
    run_dir: RunDir = None,
    key_file: With = None,
) -> None:
    """Print facts as they change, until Ctrl-C.

    Example:  rtc world watch RIGHT-ARM
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        keys = [spelt(key)] if key else None
        seen = rtc.world.view(keys=keys)
        if key and not seen.facts:
            raise _unknown(key, rtc.world)
        units = joint_units(rtc)
        _show(seen.facts, False, seen.version, units)
        with suppress(KeyboardInterrupt):
            _follow(rtc, seen, keys, every, units)


def _follow(rtc: Client, seen: View, keys: list[str] | None, every_s: float, units: JointUnits) -> NoReturn:
    while True:
        time.sleep(every_s)
        news = rtc.world.view(since=seen.version, keys=keys)
        for fact in sorted(news.facts, key=lambda fact: fact.version):
            console.print(Text(f"{fact.version:>6}  {fact.key}  {stated(fact, units)}  {fact.validity}  {_by(fact)}"))
        seen = news


@app.command()
def history(
    key: Annotated[str, typer.Argument(help="A fact (MACS-NEW.frame), or a location: all its facts.")],
    limit: Annotated[int, typer.Option(min=1, max=HISTORY, help="Maximum number, the newest first.")] = 20,
    json: AsJson = False,
    run_dir: RunDir = None,
    key_file: With = None,
) -> None:
    """Print the history of a fact, newest first, with sources.

    Example:  rtc world history MACS-NEW.frame
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        known = rtc.world.view(keys=[spelt(key)]).facts
        if not known:
            raise _unknown(key, rtc.world)
        facts = [old for fact in known for old in rtc.world.history(fact.key, limit)]
        units = joint_units(rtc)
    _show(sorted(facts, key=lambda fact: -fact.version)[:limit], json, None, units, by_key=False)


@app.command()
def at(
    version: Annotated[int, typer.Argument(min=1, help="A version of the world.")],
    key: Annotated[str, typer.Argument(help="A fact or a location; without it, everything.")] = "",
    json: AsJson = False,
    run_dir: RunDir = None,
    key_file: With = None,
) -> None:
    """Print the facts at an earlier version of the world.

    Example:  rtc world at 42 MACS-NEW
    """
    with Client(run_dir, need_broker=False, key=key_file) as rtc:
        now = rtc.world.view(keys=[spelt(key)] if key else None)
        if key and not now.facts:
            raise _unknown(key, rtc.world)
        newest = at_version(rtc, version, now)
        units = joint_units(rtc)
    _show(newest.values(), json, version, units)


def at_version(rtc: Client, version: int, now: View) -> dict[str, Fact]:
    """The facts of a view at an earlier version, by key. Raises typer.Exit if it is later than now."""
    if version > now.version:
        raise cli_error(f"there is no version {version} of the world yet; the newest is {now.version}", 2)
    newest: dict[str, Fact] = {}
    for known in now.facts:
        for fact in rtc.world.history(known.key, HISTORY):
            if fact.version <= version and (fact.key not in newest or newest[fact.key].version < fact.version):
                newest[fact.key] = fact
    return newest


def refuse_live(status: Status) -> None:
    """Raises typer.Exit, with the reason printed, while a command is in progress."""
    if live := status.commands:
        running = ", ".join(row.command for row in live)
        raise cli_error(f"in progress: {running}; wait for the end, or halt: rtc halt", 2)


@app.command()
def reset(json: AsJson = False, run_dir: RunDir = None) -> None:
    """Put the facts of all objects and seats back to those of the cell. No body is moved, neither simulated nor real.

    It is the sentence SET WORLD FACTS INITIAL: an analyzer writes the facts. Joints and hands keep theirs, because they
    are measured; taught places stay. Refused while a command is in progress or a hand holds something.

    Example:  rtc world reset
    """
    with Client(run_dir) as client:
        refuse_live(client.status())
        ended = client.run(RESET)
        seen = sorted({tag.body for tag in Cell.load(cell_of(run_dir)).tags})
    if ended.outcome.kind is not OutcomeKind.SUCCEEDED:
        print_result(ended, RESET, console)
        raise typer.Exit(exit_code([ended.outcome.kind]))
    hint = f"a body that was moved is not where the facts say: first LOCATE it ({', '.join(seen)})"
    hint = hint if seen else "a body that was moved is not where the facts say: state where it is by SET, or VERIFY it"
    if json:
        emit_json({"command": ended.command, "moved": [], "hint": hint})
    else:
        console.print(Text(f"the facts are those of the cell again ({ended.command}); no body was moved"))
        console.print(Text(hint))


def _motions(rtc: Client) -> list[MotionRow]:
    """What the arms are doing, as the broker knows it; empty without a broker that answers."""
    try:
        return rtc.status(within_s=BROKER_S).motions
    except RtcError:
        return []


def with_motions(facts: Iterable[Fact], motions: Sequence[MotionRow], now_s: float) -> list[Fact]:
    """The facts, with a fact ARM.motion for each moving arm among them: its path, and the time since its start."""
    facts = list(facts)
    known = {fact.key.partition(".")[0]: fact.version for fact in facts}
    return [
        *facts,
        *(
            Fact(
                key=f"{one.arm}.motion",
                value={name: getattr(one, name) for name in MOTION},
                validity=Validity.CHANGING,
                version=known[one.arm],
                source=one.command,
                at_s=now_s - (one.started_ago_s or 0.0),
            )
            for one in motions
            if one.arm in known
        ),
    ]


def spelt(key: str) -> str:
    """A key as in the database: the location in capitals with '-', the attribute unchanged."""
    place, dot, attribute = key.partition(".")
    return place.upper().replace("_", "-") + dot + attribute.lower()


def joint_units(rtc: Client) -> JointUnits:
    """The units of the joints of each arm, from the cell of the cluster; empty if it cannot be read now."""
    try:
        with cell_file(rtc.cell()) if rtc.far else nullcontext(rtc.settings.cell) as name:
            return units_in(Cell.load(name))
    except RtcError:
        return {}


VALUE = "value (x y z cm, roll pitch yaw deg)"


def _show(facts: Iterable[Fact], json: bool, version: int | None, units: JointUnits, *, by_key: bool = True) -> None:
    facts = sorted(facts, key=lambda fact: fact.key) if by_key else list(facts)
    if json:
        emit_json({"version": version, "facts": [msgspec.to_builtins(fact) for fact in facts]})
        return
    print_facts(facts, units)
    if version is not None:
        console.print(f"version {version} of the world, {len(facts)} facts")


def print_facts(facts: Iterable[Fact], units: JointUnits) -> None:
    out = table("fact", VALUE, "validity", "version>", "source", "age>")
    now_s = time.monotonic()
    for fact in facts:
        validity = Text(fact.validity.value, style=COLOUR.get(fact.validity, ""))
        age = seconds(max(0.0, now_s - fact.at_s))
        out.add_row(fact.key, Text(stated(fact, units)), validity, str(fact.version), Text(_by(fact)), age)
    console.print(out)


def _unknown(key: str, world: WorldClient) -> typer.Exit:
    return cli_error(unknown("fact or location", key, (fact.key.partition(".")[0] for fact in world.view().facts)), 2)


def _by(fact: Fact) -> str:
    """Who has written it: C-5 of job 7 of C-5; JSON has the job."""
    return fact.source.partition("/")[0]
