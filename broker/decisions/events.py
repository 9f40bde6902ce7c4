"""Events: the input of the Decision Unit, in the past tense, each with its time (`at_s`, CLOCK_MONOTONIC, seconds).

The journal holds exactly these events, in order; replaying them gives the same decisions. They do not know sockets.
"""

from __future__ import annotations

from enum import StrEnum

import msgspec

from rtc.protocol.messages import (
    Breakpoint,
    CommandText,
    EndReport,
    HaltAtRest,
    HaltOrder,
    PauseChanged,
    Started,
    SubsystemHello,
    WorkerKind,
)
from rtc.protocol.outcomes import Refusal


class Stimulus(StrEnum):
    """What an event means to one command: a column of the transition table (`broker.decisions.command.table`)."""

    PRODUCT = "product"  # the worker returned the product of the job
    REFUSAL = "refusal"  # the worker refused the job
    UNAVAILABLE = "unavailable"  # the world database, or every worker of the kind, is unavailable
    WORKER_LOST = "worker_lost"  # the worker died, hung or raised
    GRANT = "grant"  # all resources of its claim are free
    RELEASE = "release"  # the command it waits for has ended or begun, or the earlier ones of its client are parsed
    SPACE = "space"  # the arm in its way has begun to move or has rested, or its command has ended
    REPORT = "report"  # the end report of its primitive
    STOP = "stop"  # a HALT or ABORT reaches it
    PAUSE = "pause"
    RESUME = "resume"
    STEP = "step"  # one step, then a pause again
    REST = "rest"  # its subsystem confirms rest for the halt of its primitive
    HALT_SETTLED = "halt_settled"  # a HALT sentence only: rest is confirmed, or it is not
    TIMEOUT = "timeout"  # its timer: the end report, the confirmation of rest or the analysis is late
    SUBSYSTEM_LOST = "subsystem_lost"  # the subsystem that executes its primitive is lost


class Event(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag=True, gc=False):
    at_s: float


class CommandReceived(Event, frozen=True, kw_only=True, gc=False):
    client: str
    sentence: CommandText


class HaltCalled(Event, frozen=True, kw_only=True, gc=False):
    """A halt from a client, or from a subsystem that received it at its own halt socket."""

    client: str
    order: HaltOrder


class JobFinished(Event, frozen=True, kw_only=True, gc=False):
    job: str
    attempt: int
    node: str
    product: msgspec.Raw
    took_s: float = 0.0
    world: int = 0  # version of the world that the job read, for its repetition


class JobDeclined(Event, frozen=True, kw_only=True, gc=False):
    """A worker refused the job: a result, not a failure of the worker."""

    job: str
    attempt: int
    node: str
    refusal: Refusal
    world: int = 0  # as in JobFinished


class JobLost(Event, frozen=True, kw_only=True, gc=False):
    """The worker died, hung or raised. `blamed`: it was processing this job, so the job may be the cause. `inside`: the
    code of an installed package that it ran."""

    job: str
    attempt: int
    node: str
    evidence: str
    blamed: bool = True
    inside: str = ""


class PrimitiveStarted(Event, frozen=True, kw_only=True, gc=False):
    subsystem: str
    start: Started


class PrimitivePaced(Event, frozen=True, kw_only=True, gc=False):
    subsystem: str
    change: PauseChanged


class PrimitiveEnded(Event, frozen=True, kw_only=True, gc=False):
    subsystem: str
    report: EndReport


class HaltConfirmed(Event, frozen=True, kw_only=True, gc=False):
    """A subsystem reports whether everything in the scope of a halt is at rest."""

    answer: HaltAtRest


class ArmStrayed(Event, frozen=True, kw_only=True, gc=False):
    """An arm has moved without a primitive, and is braked. `how`: in words, without the name of the arm."""

    subsystem: str
    arm: str
    how: str


class AnswerWasRefused(Event, frozen=True, kw_only=True, gc=False):
    """The measurements of a subsystem do not prove a DONE of the operator."""

    primitive: str
    message: str


class SubsystemConnected(Event, frozen=True, kw_only=True, gc=False):
    """A subsystem connected. With a new `pid` it knows only the primitives it lists as outstanding."""

    hello: SubsystemHello


class SubsystemGone(Event, frozen=True, kw_only=True, gc=False):
    subsystem: str
    why: str


class ClientGone(Event, frozen=True, kw_only=True, gc=False):
    client: str


class TimerFired(Event, frozen=True, kw_only=True, gc=False):
    timer: str  # name given in StartTimer


class ProgramInstalled(Event, frozen=True, kw_only=True, gc=False):
    """A program (or the cell, kind None) has a new body, by its digest."""

    kind: WorkerKind | None
    digest: str
    file: str = ""  # name of the loaded file; empty: a default program
    changes: list[str] = []  # in words, against the program before


class BreakpointsChanged(Event, frozen=True, kw_only=True, gc=False):
    breakpoints: list[Breakpoint]  # all of them


class StepRequested(Event, frozen=True, kw_only=True, gc=False):
    command: str


class ListenersChanged(Event, frozen=True, kw_only=True, gc=False):
    """The event stream gained its first subscriber or lost its last: notes are published only for subscribers.

    `crowded`: too many notes are published; commands accepted now publish none.
    """

    listening: bool
    crowded: bool = False


class JournalLost(Event, frozen=True, kw_only=True, gc=False):
    """The journal lacks decisions of this run: it is new, or older than before. `accepted`: the highest command number
    known to be in use."""

    why: str
    life: str  # id of the journal from now on
    accepted: int


class BrokerRestarted(Event, frozen=True, kw_only=True, gc=False):
    """The broker started with a replayed journal: all jobs dispatched before are lost."""


AnyEvent = (
    CommandReceived
    | HaltCalled
    | JobFinished
    | JobDeclined
    | JobLost
    | PrimitiveStarted
    | PrimitivePaced
    | PrimitiveEnded
    | HaltConfirmed
    | ArmStrayed
    | AnswerWasRefused
    | SubsystemConnected
    | SubsystemGone
    | ClientGone
    | TimerFired
    | ProgramInstalled
    | BreakpointsChanged
    | StepRequested
    | ListenersChanged
    | BrokerRestarted
    | JournalLost
)
