"""rtc jog: move an arm that the operator has, by the keyboard or by lines of a file."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, cast

import typer

from rtc.apps.cli.halt import halt_by
from rtc.apps.cli.output import RunDir, With, cli_error, console
from rtc.client.client import Client
from rtc.client.hand_controller import PERIOD_S, HandController

#: key -> axis of the twist, and its sign
KEYS = {key: (axis, sign) for axis, pair in enumerate(("ws", "ad", "rf", "ui", "jk", "nm")) for key, sign in
        zip(pair, (1.0, -1.0), strict=True)}  # fmt: skip
HELD_S = 0.15  # a key counts as held for so long after its latest repetition
HALT, END = " ", "q"
ESCAPES = re.compile(r"\x1b(\[[0-9;]*[A-Za-z~]|O.|.)?", re.DOTALL)
HELP = "w s a d r f: along x y z; u i j k n m: about x y z; c o: close, open hand; - +: spindle; space: HALT; q: end"
LINE = "SECONDS VX VY VZ WX WY WZ [open|close] [turn SHARE] [tool]"
Moment = tuple[list[float], Literal["", "open", "close"], float]


def jog(
    arm: Annotated[str, typer.Argument(help="The arm, such as RIGHT-ARM.")],
    lines: Annotated[
        str, typer.Option("--lines", help=f"A file with lines {LINE} (m/s, rad/s); - is the standard input.")
    ] = "",
    speed: Annotated[float, typer.Option(min=0.001, max=1.0, help="m/s of a key; turns go at 3 rad/m of it.")] = 0.03,
    tool: Annotated[bool, typer.Option("--tool", help="Keys move along the axes of the tool.")] = False,
    name: Annotated[str, typer.Option(help="Your name, for the others.")] = "OPERATOR",
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Move an arm by hand, while the operator has it: after GIVE, or when a sentence VIA OPERATOR-INTERVENTION asks.

    Hold a key to move: the arm stops 0.15 s after the latest repetition of the key. `rtc operator` shows what you are
    asked to do.

    Example:  rtc jog RIGHT-ARM
    Example:  rtc jog RIGHT-ARM --with alice.key
    Example:  echo "2 0 0 0.02 0 0 0" | rtc jog RIGHT-ARM --lines -
    """
    with Client(run_dir, key=key) as rtc, rtc.hand(arm.upper(), name) as hand:
        if not hand.request:
            raise cli_error(f"{hand.arm} is not the operator's now: rtc do 'GIVE {hand.arm} TO OPERATOR'", 2)
        console.print(hand.request)
        refused = _by_lines(hand, lines) if lines else _by_keys(hand, rtc, speed, "tool" if tool else "world")
    if refused:
        raise cli_error(refused, 1)


def _by_lines(hand: HandController, file: str) -> str:
    """Perform each line for its time. Returns why the last one that was refused did nothing; empty: none was."""
    text = sys.stdin.read() if file == "-" else Path(file).read_text()
    refused = ""
    for seconds, (twist, fingers, turn), frame in map(_parsed, filter(str.strip, text.splitlines())):
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and hand.request:
            refused = hand.move(twist, frame=frame, hand=fingers, turn=turn) or refused
            time.sleep(PERIOD_S)
        hand.release()
    return refused


def _parsed(line: str) -> tuple[float, Moment, Literal["tool", "world"]]:
    """Raises typer.Exit, with the reason printed, for a line of another form."""
    words = line.split()
    try:
        numbers = [float(word) for word in words[:7]]
        if len(numbers) != 7:
            raise ValueError
        more = words[7:]
        fingers = next((word for word in more if word in ("open", "close")), "")
        turn = float(more[more.index("turn") + 1]) if "turn" in more else 0.0
        known = (*(["turn", more[more.index("turn") + 1]] if "turn" in more else ()), "open", "close", "tool")
        if any(word not in known for word in more):
            raise ValueError
    except (ValueError, IndexError):
        raise cli_error(f"{line!r} is not {LINE}", 2) from None
    moment = numbers[1:], cast(Literal["", "open", "close"], fingers), turn
    return numbers[0], moment, "tool" if "tool" in more else "world"


def _by_keys(hand: HandController, rtc: Client, speed: float, frame: Literal["tool", "world"]) -> str:
    if not sys.stdin.isatty():
        raise cli_error("there is no keyboard here; use --lines", 2)
    console.print(HELP)
    keyboard = sys.stdin.fileno()  # read without a buffer: what waits there could be a HALT
    key, at_s, shown = "", 0.0, ""
    with _raw():
        while request := hand.request:
            if select.select([keyboard], [], [], PERIOD_S)[0]:
                typed = os.read(keyboard, 1024)
                keys = _keys(typed)
                if HALT in keys:
                    halt_by(rtc, hand.arm)
                if not typed or END in keys:  # also a terminal that is gone
                    break
                key, at_s = keys[-1:], time.monotonic()  # the latest: what was typed before it is over
            twist, fingers, turn = _wanted(key, speed)
            acts = any(twist) or fingers or turn
            held = time.monotonic() - at_s < HELD_S and acts
            words = hand.move(twist, frame=frame, hand=fingers, turn=turn) if held else hand.release()
            cut = hand.reply.cut if hand.reply is not None else ""
            unknown = "" if acts or key in ("", HALT) else f"{key!r} moves nothing; {HELP}"
            if (unknown or words or cut or request) != shown:
                shown = unknown or words or cut or request
                console.print(shown + "\r")
    return ""


def _keys(typed: bytes) -> str:
    """The keys in what a terminal has sent, as small letters; arrows and other keys with an escape sequence are not."""
    return ESCAPES.sub("", typed.decode(errors="ignore")).lower()


def _wanted(key: str, speed: float) -> Moment:
    twist = [0.0] * 6
    if key in KEYS:
        axis, sign = KEYS[key]
        twist[axis] = sign * speed * (1.0 if axis < 3 else 3.0)
    fingers: dict[str, Literal["", "open", "close"]] = {"c": "close", "o": "open"}
    return twist, fingers.get(key, ""), {"+": 1.0, "-": -1.0}.get(key, 0.0)


@contextmanager
def _raw() -> Iterator[None]:
    """Keys are read one by one; the terminal is as before afterwards."""
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
