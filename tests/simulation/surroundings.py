"""The Decision Unit among its surroundings, as a model small enough to explore: every move that could come next.

The real `decide` on a real `State`; round it, honest but adverse: workers that may answer, refuse or die; a subsystem
that executes, brakes, rests, dies, falls silent and comes back; timers; a halt on either of its two ways; and a broker
that is killed before an event is journalled, or after that and before any one of its effects is out. Messages of the
subsystem travel in order and wait as long as they like. What goes to it arrives with the turn: whether it acts before
or after is a move of its own, so nothing the Decision Unit could see is left out.

`moves` lists what may happen, `happen` does one of them and checks what must always hold, `key` names a state without
what only grows. Times never matter: a timer that runs may ring.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import msgspec

from broker import effects as do
from broker import events as heard
from broker.decision_unit import decide
from broker.invariants import forbidden, violations
from broker.state import NIL, Command, Link, State
from broker.untold import LIMIT_S
from rtc import wire
from rtc.messages import BoundStep, CommandEnded, EndReport, Phase, WorkerKind
from rtc.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason
from tests.broker.stories import bound, give_up, go_on, mend, record, report, script, trim

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
    told: bool = False  # its steps are reports of somebody who tells: no subsystem is asked
    arms: tuple[str, ...] = ("RIGHT-ARM",)
    trims: int = 0
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
    """A halt that is called: through which of its two doors it has come, and who still brakes for it."""

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
    exit_told: bool = True
    arms: dict[str, str] = {}
    braking: list[str] = []
    kept: dict[str, StopReason] = {}  # ended, not acknowledged
    ended: dict[str, StopReason] = {}
    open: list[OpenHalt] = []  # that the broker has ordered
    shadows: dict[str, str] = {}  # scope -> call of a halt past the broker, which has not shown to know of it
    said: list[heard.AnyEvent] = []  # to the broker, on its way


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
    stopped: list[str] = []  # commands that a halt has stopped, as the broker has heard it
    estopped: list[str] = []  # the same, as the process that is the subsystem now has heard it
    outcomes: dict[str, str] = {}
    now: float = 0.0


encode = msgspec.msgpack.Encoder().encode
decode = msgspec.msgpack.Decoder(Model).decode
_encode_state, _decode_state = wire.encode, wire.decoder(State)


def first(scenario: Scenario) -> Model:
    """Before the first sentence: the subsystem is there and at rest."""
    model = Model(du=State(), mcm=Mcm(arms=dict.fromkeys(ARMS, "")), budget=dict(scenario.caps), faults=scenario.faults)
    for kind in WorkerKind:
        _hear(model, heard.ProgramInstalled(at_s=0.0, kind=kind, digest="old"))
    _hear(model, _hello(model))
    return model


# --- what may happen ---------------------------------------------------------------------------------

NEVER_EXHAUSTED = frozenset({"hand in", "work", "world told", "said", "goal", "rest", "born", "hello"})


def moves(model: Model, scenario: Scenario) -> list[Move]:
    """All that may happen next."""
    return [move for move in _moves(model, scenario) if move[0] in NEVER_EXHAUSTED or _left(model, move[0]) > 0]


def _left(model: Model, fault: str) -> int:
    return min(model.faults, model.budget.get(fault, 1))


def _moves(model: Model, scenario: Scenario) -> Iterator[Move]:
    mcm, du = model.mcm, model.du
    if model.handed_in < len(scenario.sentences):
        yield "hand in", model.handed_in
    for command in du.commands.values():
        if at_work(model, command):
            for product in products(command, scenario):
                yield "work", command.id, product
            for fault in (
                "refuse",
                "nonsense",
                "worker dies",
                "job lost in a queue",
                "world away",
                "world away for long",
            ):
                yield fault, command.id
    for command in untold_at_work(model):
        yield "world told", command
        for fault in ("told badly", "teller dies", "world still away"):
            yield fault, command
    if mcm.said:
        yield ("said",)
    for arm, primitive in mcm.arms.items():
        if not primitive:
            continue
        yield ("rest" if arm in mcm.braking else "goal"), arm
    if mcm.alive:
        yield ("mcm dies",)
        if du.subsystems["MCM"].link is not Link.LOST and not mcm.said:
            yield ("mcm silent",)
        if du.subsystems["MCM"].link is not Link.CONNECTED and not any(
            type(said) is heard.SubsystemConnected for said in mcm.said
        ):
            yield ("hello",)
        for primitive in mcm.kept:
            yield "say again", primitive
    else:
        yield ("born",)
        if not mcm.exit_told:
            yield ("exit told",)
    if not mcm.said:  # limits are long: what is said arrives within them
        for timer in model.timers:
            yield "timer", timer
    for scope in scenario.halts:
        halt = model.halts.get(f"h-{scope}")
        if halt is None or not halt.at_broker:
            yield "halt", scope
        if mcm.alive and (halt is None or not halt.at_estop):
            yield "estop", scope
        if halt is not None and halt.at_broker:
            yield "halt again", scope
        if mcm.alive and halt is not None and halt.at_estop:
            yield "estop again", scope
    yield ("broker restarts",)
    if scenario.losses:
        yield ("journal lost",)
    if _left(model, "broker dies") > 0:
        yield from _deaths(model, scenario)
    if any(s.halt_if_lost for s in scenario.sentences):
        yield ("client gone",)
    if du.programs[WorkerKind.PARSER] == "old":
        yield ("program installed",)


def _deaths(model: Model, scenario: Scenario) -> Iterator[Move]:
    """The broker is killed while it hears something: before the journal has it (None), or with so many effects out."""
    for move in _moves_of_broker(model, scenario):
        yield "broker dies", None, move
        trial = decode(encode(model))
        out = 0
        for effect in decide(trial.du, _event(trial, scenario, move)):
            if isinstance(effect, do.SendPrimitive | do.SendHalt | do.AcknowledgeReport | do.ReportEnd):
                yield "broker dies", out, move
                out += 1


def _moves_of_broker(model: Model, scenario: Scenario) -> Iterator[Move]:
    """Moves that are one event of the Decision Unit."""
    if model.handed_in < len(scenario.sentences):
        yield "hand in", model.handed_in
    for command in model.du.commands.values():
        if at_work(model, command):
            for product in products(command, scenario):
                yield "work", command.id, product
    for command in untold_at_work(model):
        yield "world told", command
    if model.mcm.said:
        yield ("said",)
    for scope in scenario.halts:
        halt = model.halts.get(f"h-{scope}")
        yield ("halt again" if halt is not None and halt.at_broker else "halt"), scope


def at_work(model: Model, command: Command) -> bool:
    """A worker has the very job the command waits for."""
    job = command.job
    return job is not None and model.given.get(job.id) == job.attempt


def untold_at_work(model: Model) -> list[str]:
    """Commands that have ended, of which a worker is telling the world."""
    return [c for c, left in model.du.deferred_analyses.items() if model.given.get(left.job.id) == left.job.attempt]


def products(command: Command, scenario: Scenario) -> list[str]:
    """What a good worker may make of the job in hand."""
    assert command.job is not None
    if command.job.kind is WorkerKind.ANALYZER and command.phase is Phase.ANALYZING:
        trims = sentence_of(command.id, scenario).trims
        return ["go on", "give up", *(f"trim {n}" for n in range(1, trims + 1))]
    return ["go on"]


def sentence_of(command: str, scenario: Scenario) -> Sentence:
    """Sentences are handed in in order, so their numbers tell."""
    return scenario.sentences[int(command[2:]) - 1]


def fair(model: Model, scenario: Scenario) -> Move | None:
    """What happens next when nothing goes wrong any more; a timer rings only when nothing else would happen."""
    mcm = model.mcm
    if not mcm.alive:
        return ("born",) if mcm.exit_told else ("exit told",)
    if mcm.said:
        return ("said",)
    if model.du.subsystems["MCM"].link is not Link.CONNECTED:
        return ("hello",)
    for arm, primitive in mcm.arms.items():
        if primitive:
            return ("rest" if arm in mcm.braking else "goal"), arm
    for command in model.du.commands.values():
        if at_work(model, command):
            return "work", command.id, "go on"
    for name in untold_at_work(model):
        return "world told", name
    if mcm.kept:
        return "say again", next(iter(mcm.kept))
    if model.handed_in < len(scenario.sentences):
        return "hand in", model.handed_in
    for timer in model.timers:
        return "timer", timer
    for command in model.du.commands.values():
        if command.phase is Phase.PAUSED:
            return "resume", command.id
    return None


# --- doing it ----------------------------------------------------------------------------------------


def happen(model: Model, scenario: Scenario, move: Move, *, paid: bool = True) -> list[do.Effect]:
    """Do one move. Raises Violation. `paid`: it counts against the faults that may happen."""
    model.now += 1.0
    name = move[0]
    if paid and name not in NEVER_EXHAUSTED:
        model.faults -= 1
        model.budget[name] = model.budget.get(name, 1) - 1
    if name in OF_MCM:
        OF_MCM[name](model, *move[1:])
        return []
    if name == "broker dies":
        _, out, inner = move
        if out is None:
            _lose(model, inner)
        else:
            _hear(model, _event(model, scenario, inner), out=out)
        return _restart(model)
    if name == "broker restarts":
        return _restart(model)
    if name == "journal lost":
        return _lose_turns(model)
    return _hear(model, _event(model, scenario, move))


def _lose_turns(model: Model) -> list[do.Effect]:
    """A broker comes that knows that turns are missing. Nothing that was live goes on."""
    done = _restart(model)
    lost = heard.JournalLost(at_s=model.now, why="lost", life="", accepted=model.du.accepted)
    done += _hear(model, lost)
    for command in model.du.commands.values():
        if command.phase not in (Phase.HALTING, Phase.CLOSING):
            raise Violation(f"{command.id} is {command.phase.value} after its journal was lost")
    return done


def _event(model: Model, scenario: Scenario, move: Move) -> heard.Event:
    return EVENTS[move[0]](model, scenario, *move[1:])


def _hand_in(model: Model, scenario: Scenario, n: int) -> heard.Event:
    model.handed_in = n + 1
    sentence = scenario.sentences[n]
    return heard.CommandReceived(
        at_s=model.now,
        client=_client(scenario, n),
        request=f"r{n}",
        text=sentence.text,
        halt_if_lost=sentence.halt_if_lost,
    )


def _client(scenario: Scenario, n: int) -> str:
    return CLIENTS[0 if scenario.one_client else n]


def _client_gone(model: Model, scenario: Scenario) -> heard.Event:
    tied = next(n for n, sentence in enumerate(scenario.sentences) if sentence.halt_if_lost)
    return heard.ClientGone(at_s=model.now, client=_client(scenario, tied))


def _work(model: Model, scenario: Scenario, command: str, product: str) -> heard.Event:
    live = model.du.commands[command]
    assert live.job is not None
    del model.given[live.job.id]
    body = _product(sentence_of(command, scenario), live.job.kind, command, live.primitives + 1, live.step, product)
    return heard.JobFinished(at_s=model.now, job=live.job.id, attempt=live.job.attempt, node="w", product=body)


@cache
def _product(
    sentence: Sentence, kind: WorkerKind, command: str, primitive: int, step: tuple[int, int] | None, product: str
) -> msgspec.Raw:
    arm = sentence.arms[0]
    match kind:
        case WorkerKind.PARSER:
            return wire.raw(record(**{"hand": arm, **dict(sentence.parsed)}))
        case WorkerKind.ELABORATOR:
            trims = [trim(n, "retry_step") for n in range(1, sentence.trims + 1)]
            return wire.raw(script(sentence.steps + sentence.empty_steps, sentence.arms, trims))
        case WorkerKind.BINDER:
            assert step is not None
            if step[0] == 0 and step[1] < sentence.empty_steps:
                return wire.raw(BoundStep(note="nothing to do"))
            if sentence.told:
                return wire.raw(BoundStep(told=report("", StopReason.GOAL), evaluation=bound("").evaluation))
            return wire.raw(bound(f"{command}.{primitive}", sentence.arms[(primitive - 1) % len(sentence.arms)]))
        case WorkerKind.ANALYZER:
            if product.startswith("trim"):
                return wire.raw(mend(int(product[5:])))
            return wire.raw(give_up() if product == "give up" else go_on())


def _about_job(
    kind: type[heard.JobFinished | heard.JobDeclined | heard.JobLost], **fields: Any
) -> Callable[[Model, Scenario, str], heard.Event]:
    def event(model: Model, scenario: Scenario, command: str) -> heard.Event:
        job = model.du.commands[command].job
        assert job is not None
        del model.given[job.id]
        return kind(at_s=model.now, job=job.id, attempt=job.attempt, node="w", **fields)

    return event


def _away_for_long(model: Model, scenario: Scenario, command: str) -> heard.Event:
    model.now += LIMIT_S + 1.0
    return _about_job(heard.JobDeclined, refusal=AWAY)(model, scenario, command)


def _about_untold(
    kind: type[heard.JobFinished | heard.JobDeclined | heard.JobLost], **fields: Any
) -> Callable[[Model, Scenario, str], heard.Event]:
    def event(model: Model, scenario: Scenario, command: str) -> heard.Event:
        job = model.du.deferred_analyses[command].job
        del model.given[job.id]
        return kind(at_s=model.now, job=job.id, attempt=job.attempt, node="w", **fields)

    return event


def _call(model: Model, scenario: Scenario, scope: str) -> heard.Event:
    _called(model, scope).at_broker = True
    return heard.HaltCalled(at_s=model.now, client=CLIENTS[0], halt=f"h-{scope}", scope=scope)


def _call_again(model: Model, scenario: Scenario, scope: str) -> heard.Event:
    return heard.HaltCalled(at_s=model.now, client=CLIENTS[1], halt=f"h-{scope}", scope=scope)


def _called(model: Model, scope: str) -> Halt:
    return model.halts.setdefault(f"h-{scope}", Halt(scope, model.handed_in))


def _hello(model: Model) -> heard.SubsystemConnected:
    mcm = model.mcm
    executing = [primitive for primitive in mcm.arms.values() if primitive]
    return heard.SubsystemConnected(
        at_s=model.now,
        subsystem="MCM",
        pid=mcm.pid,
        performers=list(ARMS),
        outstanding=executing + [primitive for primitive in mcm.kept if primitive not in executing],
        at_rest=not executing,
    )


def _gone(why: str) -> Callable[[Model, Scenario], heard.Event]:
    def event(model: Model, scenario: Scenario) -> heard.Event:
        model.mcm.exit_told = True
        return heard.SubsystemGone(at_s=model.now, subsystem="MCM", why=why)

    return event


def _next_said(model: Model, scenario: Scenario) -> heard.Event:
    return msgspec.structs.replace(model.mcm.said.pop(0), at_s=model.now)


def _ring(model: Model, scenario: Scenario, timer: str) -> heard.Event:
    at_s = model.timers.pop(timer)
    return heard.TimerFired(at_s=max(at_s, model.now), timer=timer)


def _install(model: Model, scenario: Scenario) -> heard.Event:
    return heard.ProgramInstalled(at_s=model.now, kind=WorkerKind.PARSER, digest="new")


def _resume(model: Model, scenario: Scenario, command: str) -> heard.Event:
    """The operator gives up on a paused command: it need not go on, only end."""
    return heard.HaltCalled(at_s=model.now, client=CLIENTS[0], halt=f"end-{command}", scope=command)


NO = Refusal(reason=RefusalReason.INFEASIBLE, message="no")
AWAY = Refusal(reason=RefusalReason.TIMEOUT, message="the world does not answer")
EVENTS: dict[str, Callable[..., heard.Event]] = {
    "hand in": _hand_in,
    "work": _work,
    "refuse": _about_job(heard.JobDeclined, refusal=NO),
    "nonsense": _about_job(heard.JobFinished, product=wire.raw({"no": "product"})),
    "worker dies": _about_job(heard.JobLost, evidence="exit -9"),
    "job lost in a queue": _about_job(heard.JobLost, evidence="exit -9", blamed=False),
    "world away": _about_job(heard.JobDeclined, refusal=AWAY),
    "world away for long": _away_for_long,
    "world told": _about_untold(heard.JobFinished, product=wire.raw(go_on())),
    "told badly": _about_untold(heard.JobDeclined, refusal=NO),
    "teller dies": _about_untold(heard.JobLost, evidence="exit -9"),
    "world still away": _about_untold(heard.JobDeclined, refusal=AWAY),
    "said": _next_said,
    "mcm silent": _gone("silent"),
    "exit told": _gone("exit -9"),
    "timer": _ring,
    "halt": _call,
    "halt again": _call_again,
    "client gone": _client_gone,
    "program installed": _install,
    "resume": _resume,
}


def _hear(model: Model, event: heard.Event, out: int | None = None) -> list[do.Effect]:
    """The Decision Unit hears; its effects are carried out, or only the first `out` of those that leave the broker."""
    du = model.du
    live = set(du.commands)
    halted = event.scope if isinstance(event, heard.HaltCalled) else ""
    effects = decide(du, event)
    for command in du.commands.values():
        command.notes.clear()  # told, and never read again
    du.counts.clear()
    wrong = [*violations(du), *forbidden(du, live, effects, halt_all=halted == "ALL")]
    if halted:
        model.stopped += [c for c in _stopped_by(model, live, halted) if c not in model.stopped]
    for effect in effects:
        wrong += _untrue(model, effect)
    if wrong:
        raise Violation("; ".join(wrong))
    for effect in effects:
        leaves = isinstance(effect, do.SendPrimitive | do.SendHalt | do.AcknowledgeReport | do.ReportEnd)
        if out is not None and leaves:
            if out == 0:
                break
            out -= 1
        if carry := CARRIED_OUT.get(type(effect)):
            carry(model, effect)
    return effects


def _stopped_by(model: Model, live: set[str], scope: str) -> list[str]:
    """Of a halt: the commands that must not go on. Those that hold, want or name an arm are the Decision Unit's own
    business; here the ones that hold it count, which is what an onlooker can see."""
    du = model.du
    if scope == "ALL":
        return [c for c in live if c not in du.commands or not du.commands[c].text.startswith("HALT")]
    if scope in live:
        return [scope]
    return [c for c in live if scope in du.resources.held.get(c, ())]


def _untrue(model: Model, effect: do.Effect) -> Iterator[str]:
    """What an effect must not be, seen from outside."""
    match effect:
        case do.DispatchJob() if effect.kind is not WorkerKind.ANALYZER:
            command = effect.job.partition("/")[0]
            if command in model.stopped:
                yield f"a job for {command}, which was halted"
        case do.SendPrimitive() if effect.id.partition(".")[0] in model.stopped:
            yield f"primitive {effect.id} for a command that was halted"
        case do.SendPrimitive():
            yield from _overtaken(model, effect)
        case do.ReportEnd():
            yield from _untrue_end(model, effect.ended)


def _overtaken(model: Model, effect: do.SendPrimitive) -> Iterator[str]:
    """What one client gave is begun in the order given, as far as the sentences name the same arm."""
    du, command = model.du, model.du.commands[effect.id.partition(".")[0]]
    performer = msgspec.msgpack.decode(effect.primitive)["performer"]
    for earlier in du.commands.values():  # in order of acceptance
        if earlier is command:
            return
        unread = earlier.id in du.intake_order.get(earlier.client, ())
        named = earlier.head is not None and earlier.head.hand == performer and earlier.id in du.resources.waiting
        if earlier.client == command.client and (unread or named):
            yield f"primitive {effect.id} before {earlier.id}, which was given before it"


def _untrue_end(model: Model, ended: CommandEnded) -> Iterator[str]:
    command, kind = ended.command, ended.outcome.kind
    begun = [primitive for primitive in model.begun if primitive.partition(".")[0] == command]
    moving = [p for a, p in model.mcm.arms.items() if p in begun]
    if command in model.outcomes:
        yield f"{command} ended twice: {model.outcomes[command]}, {kind.value}"
    if kind is OutcomeKind.SUCCEEDED:
        if command in model.stopped:
            yield f"{command} was halted, and succeeded"
        if begun and model.goals.get(command, 0) != len(begun):
            yield f"{command} succeeded with {model.goals.get(command, 0)} of {len(begun)} primitives at their goal"
    if moving and kind not in (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM):
        yield f"{command} ended {kind.value}, and {moving[0]} still moves"


def _restart(model: Model) -> list[do.Effect]:
    """A new broker on the old journal. What the old one had not read is gone; the subsystem introduces itself anew."""
    model.du = _decode_state(_encode_state(model.du))
    model.timers.clear()
    model.given.clear()
    model.mcm.said.clear()
    effects = _hear(model, heard.BrokerRestarted(at_s=model.now))
    if model.mcm.alive:
        _say_hello(model)
    return effects


def _lose(model: Model, move: Move) -> None:
    """What the broker had read goes with it. Some of it is said again by whoever said it."""
    if move[0] == "said":
        model.mcm.said.pop(0)
    elif move[0] == "halt":
        _called(model, move[1]).at_broker = True


def late(model: Model) -> Iterator[heard.Event]:
    """What may still arrive, or arrive once more, and must change nothing: answers of workers thought dead, answers
    and reports told twice, requests repeated, a timer that was set anew. (A halt that is repeated is obeyed again.)"""
    now, body = model.now, wire.raw(go_on())
    old = [(f"{command}/1", 1) for command in model.outcomes]
    old += [(left.job.id, left.job.attempt - 1) for left in model.du.deferred_analyses.values()]
    for live in model.du.commands.values():
        old.append((f"{live.id}/{live.jobs if live.job is None else live.jobs - 1}", 1))
        if live.job is not None:
            old.append((live.job.id, live.job.attempt - 1))
        yield heard.TimerFired(at_s=live.due_s - 0.5 if live.due_s else now, timer=live.id)
    for job, attempt in old:
        yield heard.JobFinished(at_s=now, job=job, attempt=attempt, node="late", product=body)
        yield heard.JobDeclined(at_s=now, job=job, attempt=attempt, node="late", refusal=NO)
        yield heard.JobLost(at_s=now, job=job, attempt=attempt, node="late", evidence="late")
    for primitive, reason in model.mcm.ended.items():
        if primitive not in model.mcm.kept:
            yield heard.PrimitiveEnded(at_s=now, subsystem="MCM", report=report(primitive, reason))
    for key in model.du.requests:
        client, _, request = key.partition(" ")
        yield heard.CommandReceived(at_s=now, client=client, request=request, text="X")


# --- the subsystem -----------------------------------------------------------------------------------


def _say(model: Model, event: heard.AnyEvent) -> None:
    model.mcm.said.append(event)


def _execute(model: Model, effect: do.SendPrimitive) -> None:
    mcm, id_ = model.mcm, effect.id
    if not mcm.alive or effect.pid != mcm.pid:
        return
    performer = msgspec.msgpack.decode(effect.primitive)["performer"]
    if id_ in mcm.ended:
        _report(model, id_)
        return
    if mcm.arms[performer] == id_:
        return
    scopes = ("ALL", performer, id_.partition(".")[0])
    if any(scope in scopes for scope in mcm.shadows):
        mcm.ended[id_] = mcm.kept[id_] = StopReason.HALT
        _report(model, id_)
        return
    if mcm.arms[performer]:
        raise Violation(f"{id_} was sent to {performer}, which still executes {mcm.arms[performer]}")
    if id_ in model.begun:
        raise Violation(f"{id_} is executed a second time")
    if id_.partition(".")[0] in [*model.stopped, *model.estopped]:
        raise Violation(f"{id_} begins after the halt that stopped its command")
    mcm.arms[performer] = id_
    model.begun[id_] = performer


def _report(model: Model, primitive: str) -> None:
    reason = model.mcm.ended[primitive]
    performer = model.begun.get(primitive, "RIGHT-ARM")
    body: EndReport = report(primitive, reason, performer)
    _say(model, heard.PrimitiveEnded(at_s=0.0, subsystem="MCM", report=body))


def _end(model: Model, arm: str, reason: StopReason) -> None:
    mcm = model.mcm
    primitive, mcm.arms[arm] = mcm.arms[arm], ""
    mcm.ended[primitive] = mcm.kept[primitive] = reason
    mcm.braking = [a for a in mcm.braking if a != arm]
    _report(model, primitive)


def _goal(model: Model, arm: str) -> None:
    command = model.mcm.arms[arm].partition(".")[0]
    model.goals[command] = model.goals.get(command, 0) + 1
    _end(model, arm, StopReason.GOAL)
    _confirm(model)


def _rest(model: Model, arm: str) -> None:
    _end(model, arm, StopReason.HALT)
    _confirm(model)


def _halt(model: Model, id_: str, scope: str, *, call: str) -> None:
    """Ordered by the broker. `call`: of the halt past it that this answers, if it does."""
    mcm = model.mcm
    if not mcm.alive:
        return
    mcm.shadows = {s: c for s, c in mcm.shadows.items() if c != call}
    reached = _brake(mcm, scope)
    in_scope = list(ARMS) if scope == "ALL" else [scope] if scope in ARMS else reached
    mcm.open.append(OpenHalt(id_, in_scope))
    _confirm(model)


def _brake(mcm: Mcm, scope: str) -> list[str]:
    reached = [a for a, p in mcm.arms.items() if p and (scope in ("ALL", a) or p.startswith(f"{scope}."))]
    mcm.braking += [a for a in reached if a not in mcm.braking]
    return reached


def _pass_on(model: Model, call: str, scope: str) -> None:
    _say(model, heard.HaltCalled(at_s=0.0, client="MCM", halt=call.partition("#")[0], scope=scope, call=call))


def _confirm(model: Model) -> None:
    mcm = model.mcm
    for halt in list(mcm.open):
        if not any(mcm.arms[arm] for arm in halt.performers):
            mcm.open.remove(halt)
            rest = {"subsystem": "MCM", "halt": halt.id, "at_rest": True, "performers": halt.performers}
            _say(model, heard.HaltConfirmed(at_s=0.0, **rest))


def _estop(model: Model, scope: str) -> None:
    halt = _called(model, scope)
    halt.at_estop = True
    _at_estop(model, halt, halt.handed_in)


def _estop_again(model: Model, scope: str) -> None:
    """Another halt under a name that was used before: by a second caller, or by a button that always says the same."""
    _at_estop(model, _called(model, scope), model.handed_in)


def _at_estop(model: Model, halt: Halt, handed_in: int) -> None:
    halt.estops += 1
    call = f"h-{halt.scope}#{halt.estops}"
    _brake(model.mcm, halt.scope)
    model.mcm.shadows[halt.scope] = call
    _pass_on(model, call, halt.scope)
    before = [f"C-{n}" for n in range(1, handed_in + 1)]
    model.estopped += [c for c in before if halt.scope in ("ALL", c) and c not in model.estopped]


def _die(model: Model) -> None:
    """Killed. The arms stop where they are; what was said may still arrive. What nobody else knew is forgotten."""
    mcm = model.mcm
    model.estopped.clear()
    model.mcm = Mcm(pid=mcm.pid, alive=False, exit_told=False, arms=dict.fromkeys(ARMS, ""), said=mcm.said)


def _born(model: Model) -> None:
    mcm = model.mcm
    mcm.pid, mcm.alive = mcm.pid + 1, True
    _say_hello(model)


def _say_hello(model: Model) -> None:
    _say(model, _hello(model))
    for primitive in model.mcm.kept:
        _report(model, primitive)
    for scope, call in model.mcm.shadows.items():
        _pass_on(model, call, scope)


def _say_again(model: Model, primitive: str) -> None:
    _report(model, primitive)


OF_MCM: dict[str, Callable[..., None]] = {
    "goal": _goal,
    "rest": _rest,
    "estop": _estop,
    "estop again": _estop_again,
    "mcm dies": _die,
    "born": _born,
    "hello": _say_hello,
    "say again": _say_again,
}


# --- effects -----------------------------------------------------------------------------------------


def _order_halt(model: Model, effect: do.SendHalt) -> None:
    _halt(model, effect.halt, effect.scope, call=effect.call)


def _give(model: Model, effect: do.DispatchJob) -> None:
    model.given[effect.job] = effect.attempt


def _cancel(model: Model, effect: do.CancelJob) -> None:
    model.given.pop(effect.job, None)


def _acknowledge(model: Model, effect: do.AcknowledgeReport) -> None:
    model.mcm.kept.pop(effect.primitive, None)


def _start_timer(model: Model, effect: do.StartTimer) -> None:
    model.timers[effect.timer] = effect.at_s


def _stop_timer(model: Model, effect: do.StopTimer) -> None:
    model.timers.pop(effect.timer, None)


def _ended(model: Model, effect: do.ReportEnd) -> None:
    model.outcomes[effect.ended.command] = effect.ended.outcome.kind.value


CARRIED_OUT: dict[type[do.Effect], Callable[[Model, Any], None]] = {
    do.DispatchJob: _give,
    do.CancelJob: _cancel,
    do.SendPrimitive: _execute,
    do.SendHalt: _order_halt,
    do.AcknowledgeReport: _acknowledge,
    do.StartTimer: _start_timer,
    do.StopTimer: _stop_timer,
    do.ReportEnd: _ended,
}


# --- the name of a state -----------------------------------------------------------------------------


def key(model: Model) -> tuple[bytes, bytes]:
    """(what the state is, that and which faults may still happen), each as a digest. Left out is what only grows and
    changes nothing that can follow: times, counters in names, stories, what is remembered of the ended."""
    core = encode(_essence(model))
    faults = encode([model.faults, sorted(model.budget.items())])
    return hashlib.blake2b(core, digest_size=16).digest(), hashlib.blake2b(core + faults, digest_size=16).digest()


def _essence(model: Model) -> list[Any]:
    du, mcm = model.du, model.mcm
    return [
        [_of_command(model, command) for command in du.commands.values()],
        du.resources,
        [(c, len(left.job.deaths), left.job.id in model.timers) for c, left in du.deferred_analyses.items()],
        untold_at_work(model),
        [du.awaiting, du.joining, {c: r.succeeded for c, r in du.ended.items()}],
        [(s.pid, s.link, s.came_at_rest) for s in du.subsystems.values()],
        [du.programs, list(du.trials)],
        [model.handed_in, sorted(model.timers), model.stopped, model.estopped],
        [
            (id_, halt.handed_in, halt.at_broker, halt.at_estop, halt.estops)
            for id_, halt in sorted(model.halts.items())
        ],
        [
            mcm.pid,
            mcm.alive,
            mcm.exit_told,
            [_name(model, p) for p in mcm.arms.values()],
            mcm.braking,
            [_name(model, p) for p in mcm.kept],
            [(c.id, mcm.ended.get(c.primitive)) for c in du.commands.values()],
            mcm.open,
            mcm.shadows,
            [_of_said(model, said) for said in mcm.said],
        ],
    ]


def _of_command(model: Model, c: Command) -> list[Any]:
    begun = sum(p.partition(".")[0] == c.id for p in model.begun)
    halted = [r for r, at_s in model.du.halted_at_s.items() if at_s > c.given_at_s]
    return [
        [c.id, c.phase, c.pause_wanted, c.pending_outcome, c.elaborations, c.at_rest, c.due_s > 0.0],
        c.job
        and [c.job.kind, len(c.job.deaths), c.job.program, at_work(model, c), model.now - c.job.since_s > LIMIT_S],
        [c.head is not None, c.script is not None, c.stack, c.step, c.trims_used, len(c.trim_labels), c.steps_done],
        [bool(c.primitive), min(c.primitives, 2), c.primitive_body != NIL, c.performers],
        [c.primitives - begun, begun - model.goals.get(c.id, 0), c.primitive in model.begun],
        halted,
    ]


def _name(model: Model, primitive: str) -> str:
    """Its number only matters as being the current one of its command, or not."""
    command = model.du.commands.get(primitive.partition(".")[0])
    return primitive if command is None or command.primitive != primitive else f"{command.id} now"


def _of_said(model: Model, said: heard.AnyEvent) -> list[Any]:
    match said:
        case heard.PrimitiveEnded():
            return ["end", _name(model, said.report.primitive), said.report.reason]
        case heard.SubsystemConnected():
            return ["hello", said.pid, [_name(model, p) for p in said.outstanding], said.at_rest]
        case heard.HaltConfirmed():
            return ["rest", said.halt, said.performers]
        case heard.HaltCalled():
            return ["halt", said.call]
    raise AssertionError(said)
