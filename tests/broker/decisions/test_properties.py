"""Any sequence of events, sensible or not, keeps the invariants; and once the world answers, every command ends."""

from __future__ import annotations

from hypothesis import example, given, settings
from hypothesis import strategies as st

from broker.decisions import events
from broker.decisions.decide import decide
from broker.decisions.state import NIL, Deferral, State
from rtc.protocol import wire
from rtc.protocol.messages import BoundStep, WorkerKind
from rtc.protocol.outcomes import RefusalReason, StopReason
from tests.broker.flat_events import made
from tests.broker.harness import Harness, bound, give_up, go_on, mend, record, script, stated, trim
from tests.simulation.invariants import MOVING, forbidden, violations

ARMS = (("RIGHT-ARM",), ("LEFT-ARM",), ("LEFT-ARM", "RIGHT-ARM"), ("RIGHT-ARM", "MODULE"))


class Environment(Harness):
    """Workers, MCM, clients and clock that do whatever the drawn numbers say, one event each."""

    def __init__(self) -> None:
        super().__init__()
        self.past: list[events.Event] = []
        self.pid = 1

    def handle(self, what, /, **fields):
        self.now += 0.001
        return self._decide(self.event(what, **fields))

    def _decide(self, event: events.Event):
        live = set(self.state.commands)
        effects = decide(self.state, event)
        self.log += effects
        if isinstance(event, events.HaltCalled):
            self.halted = live
        halt_all = isinstance(event, events.HaltCalled) and event.order.scope == "ALL"
        assert violations(self.state) == []
        assert forbidden(self.state, live, effects, halt_all=halt_all) == []
        if not isinstance(event, events.BrokerRestarted):
            self.past = [*getattr(self, "past", [])[-30:], event]
        return effects

    def pick(self, n: int):
        live = list(self.state.commands.values())
        return live[n % len(live)] if live else None

    def act(self, kind: int, n: int) -> None:
        ACTS[kind % len(ACTS)](self, n)

    def submit(self, n: int) -> None:
        self.says("HALT" if n % 17 == 0 else "X", halt_if_lost=n % 5 == 0)

    def work(self, n: int) -> None:
        """One pending job gets the answer that n says, good or bad."""
        command = self.pick(n)
        if command is None or command.job is None:
            return
        kind, choice = command.job.worker, n // 7
        if choice % 11 == 0:
            self.declines(command.id, RefusalReason.INFEASIBLE)
        elif choice % 13 == 0:
            self.loses_worker(command.id, blamed=choice % 2 == 0)
        elif choice % 19 == 0:
            self.answers(command.id, {"nonsense": choice})
        else:
            self.answers(command.id, self.product(kind, command, choice))

    def product(self, kind: WorkerKind, command, choice: int):
        if kind is WorkerKind.PARSER:
            other = f"C-{1 + choice % max(1, self.state.accepted)}"
            if choice % 5 == 0:
                verb = ("PAUSE", "RESUME", "ABORT", "HALT")[choice % 4]
                return record(kind="control", verb=verb, object=(other, None, "C-99")[choice % 3])
            return record(
                hand=("RIGHT-ARM", "LEFT-ARM", "BOTH-ARMS", None)[choice % 4],
                now=choice % 6 == 0,
                after=other if choice % 7 == 0 else None,
                together_with=other if choice % 8 == 1 else None,
            )
        if kind is WorkerKind.ELABORATOR:
            then = ("retry_step", "restart_script", "skip", "replace_rest", "give_up")[choice % 5]
            return script(choice % 4, ARMS[choice // 4 % len(ARMS)], [trim(1, then), trim(2, "retry_step", 0)])
        if kind is WorkerKind.BINDER:
            performer = next((r for r in command.actions.script.resources if r.endswith("ARM")), "RIGHT-ARM")
            if choice % 5 == 0:
                return BoundStep() if choice % 2 else stated()
            return bound(f"{command.id}.{command.primitives + 1}", performer)
        return (go_on(), go_on(), mend(1 + choice % 3), give_up())[choice % 4]

    def report_end(self, n: int) -> None:
        moving = [c for c in self.state.commands.values() if c.phase in MOVING and c.primitive]
        if moving:
            command = moving[n % len(moving)]
            self.reports(command.id, (StopReason.GOAL, StopReason.HALT, StopReason.CONTACT)[n % 3])

    def halt(self, n: int) -> None:
        scopes = ("ALL", "RIGHT-ARM", "LEFT-ARM", f"C-{1 + n % max(1, self.state.accepted)}", "NO-ARM")
        self.halts(scopes[n % len(scopes)], f"h{n}")

    def rest(self, n: int) -> None:
        command = self.pick(n)
        self.rests(command.id if command else f"h{n}", at_rest=n % 3 > 0)

    def ring(self, n: int) -> None:
        command = self.pick(n)
        if command is not None and command.phase.value in ("executing", "halting", "closing"):
            self.rings(command.id)

    def mcm(self, n: int) -> None:
        moving = [c.primitive for c in self.state.commands.values() if c.phase in MOVING and c.primitive_body != NIL]
        if n % 3 == 0:
            self.mcm_gone()
        else:
            self.pid += n % 2
            self.mcm_hello(self.pid, outstanding=moving[: n % 3] if n % 2 == 0 else [], at_rest=n % 5 > 0)

    def again(self, n: int) -> None:
        """An earlier event arrives once more: late, double or stale."""
        if self.past:
            self._decide(self.past[n % len(self.past)])

    def client_gone(self, n: int) -> None:
        self.handle(events.ClientGone, client="ann")

    def restart(self, n: int) -> None:
        self.state = wire.decoder(State)(wire.encode(self.state))
        self.handle(events.BrokerRestarted)

    def settle(self) -> None:
        """The environment recovers: everything gets a good answer. Nothing may be left."""
        self.mcm_hello(self.pid, outstanding=[])
        for _ in range(3000):
            if not self.state.commands and not self.state.deferred_analyses:
                return
            for command, analysis in list(self.state.deferred_analyses.items()):  # the world database is back
                if analysis.phase is Deferral.WAITING:
                    self.handle(events.TimerFired, timer=analysis.job.id)
                self.tells(command)
            for command in list(self.state.commands.values()):
                live = self.state.commands.get(command.id)
                if live is None:
                    continue
                if live.job is not None:
                    self.answers(live.id, self.sensible(live))
                elif live.phase in MOVING and live.primitive:
                    self.reports(live.id)
                elif live.phase in MOVING and self.state.halt_sentences[live.id].unconfirmed:
                    self.rests(live.id)
                elif live.phase in MOVING:  # no subsystem was there to get its halt: none will confirm it
                    self.rings(live.id)
                elif live.phase.value == "paused":
                    self.halts(live.id, f"end-{live.id}")
            self.rests("all")
        raise AssertionError(f"not ended: {[(c.id, c.phase.value) for c in self.state.commands.values()]}")

    def sensible(self, command):
        if command.job.worker is WorkerKind.BINDER:
            performer = next((r for r in command.actions.script.resources if r.endswith("ARM")), "RIGHT-ARM")
            return bound(f"{command.id}.{command.primitives + 1}", performer)
        return {WorkerKind.PARSER: record(), WorkerKind.ELABORATOR: script()}.get(command.job.worker, go_on())


ACTS = [
    *[Environment.submit] * 3,
    *[Environment.work] * 9,
    *[Environment.report_end] * 3,
    Environment.halt,
    Environment.rest,
    Environment.ring,
    Environment.mcm,
    Environment.again,
    Environment.client_gone,
    Environment.restart,
]


@settings(max_examples=300, deadline=None)
@example(acts=[(0, 1), (3, 203), (3, 7), (3, 7), (12, 0), (3, 0)])  # the last analysis is refused
@given(st.lists(st.tuples(st.integers(0, len(ACTS) - 1), st.integers(0, 100_000)), max_size=120))
def test_any_events_keep_the_invariants_and_every_command_ends(acts):
    s = Environment()
    for kind, n in acts:
        s.act(kind, n)
    s.settle()
    ends = [e.ended.command for e in s.log if type(e).__name__ == "ReportEnd"]
    assert sorted(ends) == sorted(f"C-{n}" for n in range(1, s.state.accepted + 1))  # each once
    assert s.state.resources.held == {}
    assert s.state.resources.waiting == {}
    assert s.state.resources.quarantine == {}


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(ACTS) - 1), st.integers(0, 100_000)), max_size=80))
def test_the_same_events_give_the_same_state_and_effects(acts):
    s = Environment()
    taken: list[events.Event] = []
    decided, s._decide = s._decide, lambda event: (taken.append(event), decided(event))[1]
    for kind, n in acts:
        if ACTS[kind] is not Environment.restart:
            s.act(kind, n)
    twice = []
    for _ in range(2):
        state = State()
        effects = [decide(state, event) for event in [first_hello(), *taken]]
        twice.append((wire.encode(state), effects))
    assert twice[0] == twice[1]


def first_hello() -> events.Event:
    return made(events.SubsystemConnected, at_s=0.001, subsystem="MCM", pid=1, performers=["LEFT-ARM", "RIGHT-ARM"])
