"""Records of sentences that were parsed before: the same program makes the same record of the same words. Pure.

Plans and loops repeat their sentences. A known one needs no parser, so the command goes on at once.
"""

from __future__ import annotations

import msgspec

from broker.decisions.state import Command, State
from rtc.protocol.messages import WorkerKind

MAX_PARSED = 512  # maximum number of records
CHARACTERS = 300  # maximum length of their sentences


def find(state: State, command: Command) -> msgspec.Raw | None:
    """The record of the command's sentence; None if a parser must make it."""
    return state.parsed.get(_key(command.programs.get(WorkerKind.PARSER, ""), command.text))


def keep(state: State, program: str, text: str, product: msgspec.Raw) -> None:
    """Keep what a parser has made. Without the digest of its program it is not known whose record it is."""
    if not program or len(text) > CHARACTERS:
        return
    if len(state.parsed) >= MAX_PARSED:
        state.parsed.clear()  # as good as to delete the oldest for each new one, and cheaper
    state.parsed[_key(program, text)] = product.copy()  # the original keeps its whole message alive


def _key(program: str, text: str) -> str:
    return f"{program} {text}"
