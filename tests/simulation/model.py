"""Types of the model check: scenario, move, state of the modelled subsystem and of the whole model."""

from __future__ import annotations

from typing import Any

import msgspec

from broker.decisions import events
from broker.decisions.state import Command, State
from rtc.protocol.outcomes import StopReason

ARMS = ("LEFT-ARM", "RIGHT-ARM")


CLIENTS = ("ann", "bob", "eve")


Move = tuple[Any, ...]  # its name, then what it is about


class Violation(AssertionError):
    """Something that must always hold does not. `after`: the fair moves that led there, if any did."""

    def __init__(self, what: str) -> None:
        super().__init__(what)
        self.after: list[Move] = []


class Sentence(msgspec.Struct, frozen=True, kw_only=True):
    """One command of a scenario: what its workers make of it."""

    text: str = "X"
    parsed: tuple[tuple[str, Any], ...] = ()  # fields of its record
    steps: int = 1  # with a primitive each
    empty_steps: int = 0  # before them, without one
    stated: bool = False  # its steps are stated facts, without a subsystem
    arms: tuple[str, ...] = ("RIGHT-ARM",)
    trims: int = 0
    moves: bool = False  # its arm leaves its place
    meets: str = ""  # the arm that may be in its way
    halt_if_lost: bool = False


class Scenario(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    sentences: tuple[Sentence, ...]
    one_client: bool = False  # gives them all, so they go in order; otherwise each is another's
    halts: tuple[str, ...] = ("ALL",)  # scopes that may be called, each once
    faults: int = 2  # of all kinds together
    caps: dict[str, int] = {}  # of one kind, where not 1
    losses: bool = False  # the journal may lose turns, which the next broker notices


class Halt(msgspec.Struct):
    """A halt that is called: by which of its two endpoints it has come, and which performers still brake for it."""

    scope: str
    handed_in: int  # commands that were there when it was called
    at_broker: bool = False
    at_estop: bool = False
    estops: int = 0  # how often it was called past the broker


class OpenHalt(msgspec.Struct):
    id: str
    performers: list[str]


class Mcm(msgspec.Struct):
    """The subsystem. Arms: performer -> the primitive it executes, or nothing."""

    pid: int = 1
    alive: bool = True
    exit_reported: bool = True
    arms: dict[str, str] = {}
    braking: list[str] = []
    paused: list[str] = []  # primitives that stand on their path
    kept: dict[str, StopReason] = {}  # ended, not acknowledged
    ended: dict[str, StopReason] = {}
    open: list[OpenHalt] = []  # that the broker has ordered
    fences: dict[str, str] = {}  # scope -> call of a halt past the broker, which has not shown to know of it
    outbox: list[events.AnyEvent] = []  # to the broker, on its way


class Model(msgspec.Struct):
    du: State
    mcm: Mcm
    budget: dict[str, int]
    faults: int
    handed_in: int = 0
    given: dict[str, int] = {}  # jobs that workers have: job -> attempt
    timers: dict[str, float] = {}
    halts: dict[str, Halt] = {}
    begun: dict[str, str] = {}  # primitive -> performer, by whatever process
    goals: dict[str, int] = {}  # command -> primitives that reached their goal
    cut: dict[str, int] = {}  # command -> primitives that were stopped on their way, because of another arm
    stopped: list[str] = []  # commands that a halt has stopped, as the broker has received it
    estopped: list[str] = []  # the same, as the process that is the subsystem now has received it
    outcomes: dict[str, str] = {}
    now: float = 0.0


encode = msgspec.msgpack.Encoder().encode


decode = msgspec.msgpack.Decoder(Model).decode


NEVER_EXHAUSTED = frozenset({"hand in", "work", "world written", "delivered", "goal", "rest", "born", "hello"})


def at_work(model: Model, command: Command) -> bool:
    """A worker has the very job the command waits for."""
    job = command.job
    return job is not None and model.given.get(job.id) == job.attempt


def deferred_at_work(model: Model) -> list[str]:
    """Commands that have ended, whose last analysis a worker still writes."""
    return [c for c, left in model.du.deferred_analyses.items() if model.given.get(left.job.id) == left.job.attempt]


def sentence_of(command: str, scenario: Scenario) -> Sentence:
    """Sentences are handed in in order, so their numbers tell."""
    return scenario.sentences[int(command[2:]) - 1]
