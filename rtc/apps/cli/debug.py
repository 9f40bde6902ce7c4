"""rtc break, rtc step: pause commands before chosen steps of their scripts, and perform one step at a time (R101)."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from rtc.apps.cli.output import AsJson, RunDir, With, cli_error, console, emit_json
from rtc.apps.cli.trace import last_number, number
from rtc.client.client import Client
from rtc.language.dictionary import verbs
from rtc.protocol.messages import Breakpoint

PLACE = re.compile(r"([A-Z-]+):([1-9][0-9]{0,3})", re.IGNORECASE)


def break_(
    places: Annotated[
        list[str] | None, typer.Argument(help="VERB:STEP, such as GRASP:5. Without one the breakpoints are listed.")
    ] = None,
    clear: Annotated[bool, typer.Option("--clear", help="Remove these breakpoints; without a place, all.")] = False,
    run_dir: RunDir = None,
    key: With = None,
    json: AsJson = False,
) -> None:
    """Set breakpoints: each command of the verb pauses before that step of its script.

    The number of a step is that of `rtc trace`: "5 of 11"; looks that come first count. RESUME goes on; `rtc step`
    performs one step.

    Example:  rtc break GRASP:5
    Example:  rtc break --clear
    """
    named = [_checked(place) for place in places or []]
    with Client(run_dir, key=key) as rtc:
        found = rtc.status().breakpoints
        if clear:
            found = rtc.set_breakpoints([one for one in found if named and one not in named])
        elif named:
            found = rtc.set_breakpoints(list(dict.fromkeys([*found, *named])))
    console.print("breakpoints: " + (", ".join(map(str, found)) or "none"))
    if json:
        emit_json({"breakpoints": [str(one) for one in found]})


def _checked(place: str) -> Breakpoint:
    """Raises typer.Exit, with the reason printed, for a place without a verb of the language and a number."""
    found = PLACE.fullmatch(place)
    if found is None or found[1].upper() not in verbs():
        raise cli_error(f"{place} is not VERB:STEP, such as GRASP:5; rtc dictionary lists the verbs", 2)
    return Breakpoint(found[1].upper(), int(found[2]))


def step(
    command: Annotated[str, typer.Argument(help="Number of a paused command.", show_default="the last one")] = "",
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Let a paused command perform one step, and pause again. RESUME lets it go on to its end.

    Example:  rtc step C-7
    """
    with Client(run_dir, key=key) as rtc:
        name = number(command) if command else last_number(rtc)
        rtc.step(name)
        record = rtc.trace(name)
    console.print(f"{name} performs a step: {record.notes[-1].step}")
