"""What several sockets share: the base of all messages, limits, kinds of worker, signs of life."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import msgspec


class Message(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag=True, gc=False):
    """Base of all messages. They contain no reference cycles, so the garbage collector does not track them."""


# Limits of what a peer chooses and the receiver keeps; a message above them is not decoded.
NODES = 1 << 16  # number of addresses of workers
PROGRAM_BYTES = 128 << 10  # maximum size of a program file; the longest default program has 7 kB
Name = Annotated[str, msgspec.Meta(max_length=200)]  # characters


class Hello(Message, frozen=True, kw_only=True):
    """The first message of a process to the broker, and the broker's first to a client (Welcome).

    The receiver refuses a `protocol` other than its own with Declined, and ignores abilities that it does not know."""

    protocol: int = 1  # that is rtc 0.1, which states none; others state rtc.protocol.versions.VERSION
    abilities: Annotated[list[Name], msgspec.Meta(max_length=100)] = []  # of rtc.protocol.versions


class HelloWanted(Message, frozen=True, kw_only=True):
    """The sender does not know the receiver, a worker or a subsystem, which must send its hello again."""


class WorkerKind(StrEnum):
    """The four kinds of worker; the position of a kind gives the two low bits of a node's cube address."""

    PARSER = "parser"
    ELABORATOR = "elaborator"
    BINDER = "binder"
    ANALYZER = "analyzer"


REHEARSER = "rehearser"  # in the place of a kind: a worker that performs TEST sentences on paper, with all programs


class Breakpoint(msgspec.Struct, frozen=True):
    """Before this step of the script of each command of a verb: GRASP:5."""

    verb: Name
    step: Annotated[int, msgspec.Meta(ge=1)]

    def __str__(self) -> str:
        return f"{self.verb}:{self.step}"


class Heartbeat(Message, frozen=True, kw_only=True):
    """Sign of life. From a worker, a subsystem, or a client with `halt_if_lost`.

    The broker returns that of a registered worker if it has a time."""

    name: Name
    at_s: float = 0.0  # clock of the worker; 0 = no answer wanted
    # From a worker: how long the answer to an earlier one took; None = not measured again.
    round_trip_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] | None = None
    # How far it has come, by its own time: of a worker, the processor time of the job in progress (s); of a simulator,
    # the simulated time since its start. Time limits count this time, because a busy machine only makes it pass slower.
    own_s: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    inside: str = ""  # of a worker: the code of an installed package that runs now, "phase NAME"


class PictureTime(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """What pictures of a camera have taken lately, from the exposure until they were evaluated (s)."""

    whole_s: float
    window_s: float | None = None  # each window of a picture of which only windows were taken; None: none yet


class Shutdown(Message, frozen=True, kw_only=True):
    """End in order: the cluster (from a client) or a retiring worker. From the supervisor to the broker: halt
    everything, accept no more commands, and answer AllEnded."""

    request: Name = ""
    why: str = ""  # to a worker that the gateway rejects: the reason


class UnreadableMessages(Message, frozen=True, kw_only=True):
    """Number of unreadable messages by socket since the start of the process, for `rtc status`. Sent now and then by
    the processes that have sockets of their own (MCM, world database)."""

    counts: Annotated[dict[Name, int], msgspec.Meta(max_length=10)]
