"""Sentences of one list and their order: labels that later ones may name, and sentences that last until stopped.

Pure. On paper a sentence begins when the one before it has ended, as `rtc do` gives them.
"""

from __future__ import annotations

from collections.abc import Collection

import msgspec

from rtc.protocol.causes import UnknownName
from rtc.protocol.messages import Paper, Script
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.sentence import BOTH_ARMS, ParsedCommand
from workers.rehearsal.performance import Performance

LAST = "LAST"


def refuse_unknown(parsed: ParsedCommand, before: Paper, live: Collection[str]) -> None:
    """Refuse a sentence that names a command which is neither earlier in its list nor one of `live`."""
    stops = parsed.object if parsed.kind == "control" and (parsed.object or "").startswith("C-") else None
    for name in filter(None, (parsed.after, parsed.together_with, stops)):
        if name in before.begun or name in live or (name == LAST and before.begun):
            continue
        earlier = f"; the sentences before are {', '.join(before.begun)}" if before.begun else ""
        done = "in progress or has succeeded" if name == parsed.after else "in progress"
        none = f"no sentence before this one is {name}, and no command {name} is {done}{earlier}"
        raise Refused.because(
            RefusalReason.NAME,
            "no sentence is before this one" if name == LAST else none,
            where=name,
            expected=before.begun,
            clears=f"test it in one list with the sentence {'before it' if name == LAST else name}",
            cause=UnknownName(what="sentence", name=name),
        )


def refuse_lasting(done: Performance, before: Paper) -> None:
    """Refuse a sentence that needs what an earlier one keeps until it is stopped."""
    if done.script is None or done.refusal is not None:
        return
    for label, names in before.lasting.items():
        if both := [name for name in alone(done, done.script) if name in names]:
            message = f"{both[0]} is in use by {label}, which lasts until it is stopped"
            raise Refused.because(
                RefusalReason.RESOURCE,
                message,
                where=both[0],
                owner=label,
                clears=f"ABORT {label} before this sentence",
            )


def alone(done: Performance, script: Script) -> list[str]:
    """What the sentence alone may use: its arms, and the names whose facts it changes. A camera serves several."""
    cameras = {camera.name for camera in done.model.cell.cameras}
    return [*(name for name in script.resources if name not in cameras), *script.writes]


def begun(before: Paper, done: Performance, label: str) -> Paper:
    """The world after a sentence that was performed on paper."""
    lasting = dict(before.lasting)
    if label and done.script is not None and any(step.until_stopped for step in done.steps):
        lasting[label] = alone(done, done.script)
    return Paper(
        facts=done.world.predicted(),
        at_s=done.now_s,
        begun=[*before.begun, *([label] if label else [])],
        lasting=lasting,
    )


def stopped(before: Paper, parsed: ParsedCommand, label: str) -> Paper:
    """The world after a control sentence: what it stops does not last any longer. It moves nothing."""
    scope = parsed.object or parsed.hand or "ALL"
    ends = parsed.verb in ("HALT", "ABORT")
    lasting = {
        name: names
        for name, names in before.lasting.items()
        if not ends or not (scope in ("ALL", BOTH_ARMS, name) or scope in names)
    }
    return msgspec.structs.replace(before, lasting=lasting, begun=[*before.begun, *([label] if label else [])])
