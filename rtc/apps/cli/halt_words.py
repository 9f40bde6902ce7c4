"""The result of a halt in words: lines of pieces, each with its style. Imports little, so that `rtc halt` ends fast."""

from __future__ import annotations

from pathlib import Path

from rtc.client.halt import HaltResult, SubsystemHalt
from rtc.language.refuse import visible
from rtc.protocol.messages import CommandRecord, CommandRow, Phase
from rtc.protocol.outcomes import RtcError

Line = list[tuple[str, str]]  # pieces of a line: text, and a key of STYLES

#: style, as rich reads it -> the codes of a terminal
STYLES = {"": "", "bold": "1", "bold green": "1;32", "bold white on red": "1;37;41"}
BAD = "bold white on red"
MOVES = (Phase.EXECUTING, Phase.HALTING)
SETTLED_S, SETTLED = 0.05, " (but a hand still pressed, or a touch still gave way)"
LATE_S = 0.2  # an MCM that answers later may have been restarted and have lost a motion


def in_words(result: HaltResult) -> list[Line]:
    lines: list[Line] = [[(f"HALT {result.scope}: ", "bold"), *_result(result)]]
    if result.unknown:
        lines.append([(f"nothing that moves is known as {result.unknown}: ALL was halted", "")])
    if "halt" not in result.sent_to:
        late = "the broker did not get this order; subsystems pass it on, and start nothing until the broker has it"
        lines.append([(late, "")])
    return lines


def confirmed(found: SubsystemHalt, awaited: list[str]) -> Line:
    """A subsystem has confirmed rest while others have not."""
    rest_s = found.rest_s or 0.0
    words = f"{found.name}: rest confirmed after {rest_s * 1e3:.0f} ms"
    return [(words, "bold green"), (f"; waiting for {', '.join(awaited)}", "")]


def _result(result: HaltResult) -> Line:
    if result.declined:
        return [(f"NOTHING HALTED: {result.message}", BAD)]
    rest = max((sub.rest_s for sub in result.subsystems if sub.rest_s is not None), default=None)
    if result.latency_s is None:  # a camera that takes no picture has nothing to decelerate
        if not result.confirmed:
            return [(f"REST NOT CONFIRMED: {result.message}", BAD)]
        return [("nothing was moving; ", ""), (f"rest confirmed after {(rest or 0.0) * 1e3:.0f} ms", "bold green")]
    nothing = f"nothing of {result.scope} moves: it has ended, or has not begun"
    late = "nothing moves; it is not known whether something moved at the call"
    resting = "no joint was moving" + (SETTLED if (rest or 0.0) - result.latency_s > SETTLED_S else "")
    still = nothing if not result.reached else late if result.latency_s > LATE_S else resting
    what = f"{', '.join(result.moving)} decelerating" if result.moving else f"{still}; the order arrived"
    first = (f"{what} after {result.latency_s * 1e3:.2f} ms; ", "")
    if result.confirmed and rest is not None:
        return [first, (f"rest confirmed after {rest * 1e3:.0f} ms", "bold green")]
    return [first, (f"REST NOT CONFIRMED: {result.message}", BAD)]


def state_of(command: str, run_dir: Path | str | None, key: Path | None) -> list[str]:
    """The lines about a command that the halt did not reach; none if the broker does not answer."""
    from rtc.client.client import Client  # its import is slow, and the halt itself does not need it

    try:
        with Client(run_dir, key=key) as rtc:
            return [not_reached(rtc.trace(command), rtc.status().commands)]
    except RtcError:
        return []


def not_reached(record: CommandRecord, commands: list[CommandRow]) -> str:
    """The state of a command that moves nothing, and what moves instead. `commands`: rows of the status."""
    if record.outcome is None:
        state = f"{record.command} is {record.phase.value} and moves nothing"
    else:
        state = f"{record.command} has ended: {record.outcome.kind.value.replace('_', ' ')}"
    others = [row for row in commands if row.phase in MOVES and row.command != record.command]
    moving = [f"{row.command} ({', '.join(row.resources)}): rtc halt {row.command}" for row in others]
    return f"{state}; " + (f"in motion: {'; '.join(moving)}" if moving else "no command is in motion")


def as_text(lines: list[Line], colours: bool) -> str:
    """For a stream; `colours`: with the codes of a terminal. Control characters of names are shown, not obeyed."""
    return "".join("".join(_piece(*piece, colours) for piece in line) + "\n" for line in lines)


def _piece(text: str, style: str, colours: bool) -> str:
    text = visible(text)
    return f"\x1b[{STYLES[style]}m{text}\x1b[0m" if colours and style else text
