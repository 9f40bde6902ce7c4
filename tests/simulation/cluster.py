"""A whole cluster on a simulated clock. One seed determines all messages, their times, and all failures.

The real parts are the broker's loop (`broker.router.loop`) with its Decision Unit, worker registry, timers and journal,
every byte on its sockets, and replay after a crash. Real are also the MCM's subsystem and executors, and the world
database's server and store. Simulated: clock, sockets and the other processes (tests/simulation/processes.py).

What must hold is checked after each batch of the broker (`tests.simulation.invariants`), in each message of the MCM
(`ledger`) and at the end. `simulated_broker` can be killed at any point; `cluster_faults` has all faults.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

import msgspec

from broker.decisions.events import CommandReceived, Event, HaltCalled
from broker.decisions.state import State
from broker.persistence.journal import SCHEMA, Journal
from broker.persistence.replay import replay
from rtc.language.fastpath import halt_scope
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind, Refusal, StopReason
from rtc.runtime.handover import Handover
from rtc.world.server import Server
from rtc.world.store import Store
from tests.simulation import network, skills
from tests.simulation.cluster_faults import FAULTS
from tests.simulation.invariants import violations
from tests.simulation.ledger import Ledger
from tests.simulation.processes import ARMS, Caller, Client, Mcm, Supervisor, Worker
from tests.simulation.simulated_broker import SETTINGS, Broker

FAULTS_S = 1.2  # duration of sentences and faults; then everything may end
LIMIT_S = 150.0  # of simulated time until everything must have ended
KEY = bytes(32)

REHEARSES = 1 + (1 << 10)  # node of the rehearser


class Wrong(AssertionError):
    """Something that must always hold does not."""


class Cluster:
    LIFE = ""  # of the first journal
    TESTS = True  # there is a rehearser, and clients give TEST sentences

    def __init__(self, seed: int, log_line: Callable[[str], None] | None = None) -> None:
        self.seed = seed
        self.random = Random(seed)
        self.clock = network.Clock(self.random)
        self.log_line = log_line
        self.over = False
        self.problems: list[str] = []
        self.faults: Counter[str] = Counter()
        self.ledger = Ledger(self)
        self.dies_after_commit = 0.0
        self._lines: list[tuple[str, network.Dealer]] = []
        self._pids = iter(range(100, 10_000))
        self._db = sqlite3.connect(":memory:", isolation_level=None)
        self._db.executescript(SCHEMA)
        Journal(self._db).snapshot(State(life=self.LIFE))
        self.handed = self.hand_over()
        self.world = Server(Store(":memory:"), KEY)
        self.world_back_s = 0.0
        self.records: dict[str, m.CommandRecord] = {}
        self.broker: Broker | None = None
        self._start_broker()
        self.workers: dict[str, Worker] = {}
        self.supervisor = Supervisor(self)
        for node in range(4 * self.random.choice((1, 1, 2))):
            self._start_worker(node)
        if self.TESTS:
            self._start_worker(REHEARSES)
        self.mcm: Mcm | None = Mcm(self, next(self._pids))
        self.clients = [Client(self, f"client-{n}") for n in range(self.random.choice((1, 2)))]
        self.callers: list[Caller] = []

    def hand_over(self) -> Handover:
        """What the supervisor gives to the processes."""
        return Handover(SETTINGS, KEY)

    def broker_begins(self, broker: Broker, journal: Journal) -> None:
        """A broker has replayed its journal and has not made a turn yet."""

    @property
    def faults_there_are(self) -> Sequence[Callable[[Any], None]]:
        return FAULTS

    # --- the run --------------------------------------------------------------------------------------

    def run(self) -> None:
        """Until all is over. Raises Wrong."""
        self._plan()
        began_s = self.clock.now_s
        while not self._all_over():
            if self.clock.now_s - began_s > LIMIT_S:
                live = self.broker.state.commands.values() if self.broker else ()
                self.wrong(f"not over after {LIMIT_S:g} s: {[(c.id, c.phase.value) for c in live]}")
            self.clock.step()
            if self.problems:
                raise Wrong("; ".join(self.problems))
        self.over = True
        self._check()
        if self.problems:
            raise Wrong("; ".join(self.problems))

    def _all_over(self) -> bool:
        if (
            self.clock.now_s < network.START_S + FAULTS_S + 0.1
            or self.broker is None
            or not self.broker.alive
            or self.mcm is None
        ):
            return False
        if any(client.open for client in self.clients) or self.broker.state.commands:
            return False
        # a closed arm waits for its MCM, a kept report for its acknowledgement
        waits = self.broker.state.resources.quarantine or self.mcm.subsystem.outstanding or self.mcm.stopped
        return not waits and self.mcm.line.router is not None

    def _plan(self) -> None:
        random, clock = self.random, self.clock
        for client in self.clients:
            for _ in range(random.randint(1, 3)):
                clock.after(random.uniform(0.15, FAULTS_S * 0.8), client.submit, self._sentence())
        for n in range(random.choice((0, 0, 0, 1, 1, 2, 3))):
            scope = random.choice(("ALL", "ALL", "LEFT-ARM", "RIGHT-ARM", f"C-{random.randint(1, 4)}"))
            halt = random.choice((f"H-{n}", "THE-BUTTON"))  # two callers, or one button with a fixed name
            clock.after(random.uniform(0.01, FAULTS_S), self._call_halt, halt, scope)
        for _ in range(random.choice((0, 1, 1, 2, 3, 5))):
            fault = random.choice(self.faults_there_are)
            clock.after(random.uniform(0.005, FAULTS_S), fault, self)
        if random.random() < 0.3:
            clock.after(random.uniform(0.05, FAULTS_S / 2), self._impostor)
        self.dies_after_commit = random.choice((0.0, 0.0, 0.0, 0.2))
        clock.after(FAULTS_S, self._calm_down)

    def _impostor(self) -> None:
        """A peer takes the identity of a connected client, and disconnects again. (It does not outlive the
        broker: one that connects to the next broker first has the identity there.)"""
        name = self.clients[0].name
        if self.clients[0].line.router is None:  # not connected to this broker yet: the impostor would be the first
            return
        self.log(f"an impostor of {name} connects for a moment")
        impostor = network.Dealer(self.clock, name.encode(), lambda parts: None)
        self.clock.after(0.0005, self._connect, "front", impostor)
        self.clock.after(self.random.uniform(0.01, 0.3), impostor.close)

    def _sentence(self) -> str:
        random = self.random
        odd = random.random()
        if odd < 0.12:
            other = f"C-{random.randint(1, 4)}"
            controls = ("HALT", f"HALT {other}", "HALT RIGHT-ARM", f"ABORT {other}")
            return random.choice((*controls, "NO", "STUCK", "POISON", *(("TEST DO LEFT swing",) if self.TESTS else ())))
        words = ["DO", random.choice(("LEFT", "RIGHT")), *random.choices(skills.STEPS[:3], k=random.randint(1, 3))]
        if odd < 0.4:
            words.append(random.choice(skills.STEPS[3:]))
        if odd > 0.85:
            other = f"C-{random.randint(1, 3)}"
            words += random.choice((["AFTER", other], ["TOGETHER-WITH", other], ["NOW"]))
        return " ".join(words)

    def _calm_down(self) -> None:
        self.dies_after_commit = 0.0
        if self.broker is not None:
            self.broker.dies_in_journal, self.broker.sends_left = "", None

    def _call_halt(self, halt: str, scope: str) -> None:
        knows_broker = self.random.random() < 0.7
        self.log(f"HALT {scope} is called ({halt}){'' if knows_broker else ', at the estop socket of the MCM alone'}")
        number = len(self.callers) + 1
        self.callers.append(Caller(self, number, halt, scope, knows_broker=knows_broker))

    # --- processes ------------------------------------------------------------------------------------

    def attach(self, socket: str, line: network.Dealer) -> None:
        """A process's line to one of the broker's sockets; it is connected whenever there is a broker."""
        self._lines = [(name, other) for name, other in self._lines if not other.dead]
        self._lines.append((socket, line))
        if self.broker is not None and self.broker.alive:
            self.clock.after(0.0005, self._connect, socket, line)

    def _connect(self, socket: str, line: network.Dealer) -> None:
        if self.broker is not None and self.broker.alive and line.router is None:
            line.connect(self.broker.sockets[socket])

    def _start_broker(self) -> None:
        self.broker = broker = Broker(self, self._db, next(self._pids))
        self.log(f"broker {broker.pid} is up")
        if self.random.random() < 0.3:
            broker.router.core.journal.events_since_snapshot = 10**9  # a snapshot with its first turn
        broker.turn()
        for socket, line in self._lines:
            self.clock.after(self.random.uniform(0.001, 0.1), self._connect, socket, line)

    def _start_worker(self, node: int) -> None:
        kind = list(m.WorkerKind)[node % 4]
        name = f"{kind.value}@{node}" if node != REHEARSES else f"{m.REHEARSER}@0"
        self.workers[name] = Worker(self, name, node, kind, next(self._pids))
        self.supervisor.send_table()

    def _start_mcm(self) -> None:
        self.mcm = Mcm(self, next(self._pids))
        self.log(f"MCM {self.mcm.pid} is up")

    def process(self, name: str) -> Worker | Mcm | None:
        return self.mcm if name == "MCM" else self.workers.get(name)

    def kill(self, process: Worker | Mcm | Broker, why: str = "") -> None:
        """kill -9; the supervisor sees it and starts it anew."""
        if not process.alive:
            return
        self.log(f"{process.name} {process.pid} is killed {why}")
        process.die()
        self.clock.after(0.0005, self.supervisor.died, process.name, process.pid)
        random, after = self.random, self.clock.after
        if isinstance(process, Broker):
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")
            after(random.uniform(0.02, 0.3), self._start_broker)
        elif isinstance(process, Mcm):
            after(random.uniform(0.02, 0.4), self._start_mcm)
        else:
            after(random.uniform(0.005, 0.1), self._start_worker, process.node)

    # --- what processes do here -----------------------------------------------------------------------

    @property
    def world_away_s(self) -> float:
        """How long the world database will not answer."""
        return self.world_back_s - self.clock.now_s

    def commit(self, lease: m.Lease, changes: list[m.WorldChange] | None) -> Refusal | None:
        """Of a worker, to the world database; now and then the first answer is lost, and it asks again.

        `changes`: None makes the leased facts suspect."""
        request: m.Commit | m.Doubt = m.Doubt(request="1", lease=lease, why=lease.job)
        if changes is not None:
            request = m.Commit(request="1", lease=lease, changes=changes, source=lease.job)
        for _ in range(1 + (self.random.random() < 0.05)):
            answer = self.world.answer(request, self.clock.now_s)
            self.world.store.save()
        return answer.refusal if isinstance(answer, m.WorldRefused) else None

    def journalled(self, events: list[Event], records: list[m.CommandRecord]) -> None:
        """A turn of the broker is on record: what it decided must be right, and true."""
        assert self.broker is not None
        if self.log_line:
            for event in events:
                self.log(f"  broker gets {_in_words(event)}")
        for event in events:
            scope: str | None = None
            if isinstance(event, HaltCalled):
                scope = event.order.scope
            elif isinstance(event, CommandReceived):
                scope = halt_scope(event.sentence.text)
            if scope:
                self.ledger.last_halt_s[scope] = event.at_s
        for problem in violations(self.broker.state):
            self.wrong(problem)
        for record in records:
            self._true(record)

    def _true(self, record: m.CommandRecord) -> None:
        command, outcome = record.command, record.outcome
        assert outcome is not None
        self.log(f"    {command} ends: {outcome.kind.value} {outcome.message}")
        if command in self.records:
            self.wrong(f"{command} ended twice")
        self.records[command] = record
        begun, ended = self.ledger.of(command), self.ledger.ended
        kind = outcome.kind
        done = [name for name in begun if ended.get(name) is not StopReason.BLOCKED]  # that is stopped, and done again
        whole = len(done) == skills.primitives_of(record.text) and all(primitive in ended for primitive in begun)
        if kind is OutcomeKind.SUCCEEDED and record.text.startswith("DO") and not whole:
            self.wrong(f"{command} succeeded with {begun} begun of '{record.text}', ended: {ended}")
        moving = [e.primitive_id for e in self._executors() if e.primitive_id in begun]
        if moving and kind not in (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM):
            self.wrong(f"{command} ended {kind.value}, and {moving[0]} is still executed")
        if kind is OutcomeKind.HALTED and record.text.startswith("DO"):
            arm = skills.ARMS[record.text.split()[1]]
            sent_s, _ = self.given(command, record)
            halts = self.ledger.last_halt_s.items()  # one of another command also halts those that wait for it
            if not any(at_s >= sent_s for scope, at_s in halts if scope in ("ALL", arm) or scope.startswith("C-")):
                self.wrong(f"{command} ended halted, and no halt of it was received after it was sent")
        if kind in (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM) and not (
            self.faults["MCM"] or (record.text.startswith("HALT") and self.faults["broker"])
        ):
            self.wrong(f"{command} ended {kind.value}, and the MCM was never away")

    def _executors(self) -> list[Any]:
        return list(self.mcm.subsystem.executors.values()) if self.mcm is not None and self.mcm.alive else []

    def given(self, command: str, record: m.CommandRecord | None = None) -> tuple[float, float]:
        """When its client sent it, and when it was accepted."""
        assert self.broker is not None
        known = record or self.broker.state.commands.get(command) or self.records.get(command)
        if known is None:  # the journal lost it
            return self.clock.now_s, self.clock.now_s
        (sentence,) = (c.texts[known.request] for c in self.clients if known.request in c.texts)
        return sentence.sent_at_s, known.accepted_at_s

    # --- at the end -----------------------------------------------------------------------------------

    def _check(self) -> None:
        assert self.broker is not None
        state = self.broker.state
        sent = {request: client for client in self.clients for request in client.texts}
        for request, client in sent.items():
            result = client.results.get(request)
            if not isinstance(result, m.CommandEnded):
                self.wrong(f"{request} has no outcome: {result}")
            elif (record := self.records.get(result.command)) is None or record.outcome != result.outcome:
                self.wrong(f"{request} got {result.outcome}, the record has {record and record.outcome}")
        if state.accepted != len(sent) and not state.lost:
            self.wrong(f"{len(sent)} sentences became {state.accepted} commands")
        for what in ("held", "waiting", "holders", "lines", "quarantine"):
            if left := getattr(state.resources, what):
                self.wrong(f"{what} is not empty: {left}")
        again, _ = replay(Journal(self._db))
        if wire.encode(again) != wire.encode(state):
            self.wrong("replayed, the journal gives another state")
        self._check_world()

    def _check_world(self) -> None:
        """Each job wrote once; and what a command did that succeeded is written, in order."""
        for arm in ARMS:
            facts = self.world.store.history(f"{arm}.done", 1000)[::-1]
            for job, times in Counter(fact.source for fact in facts).items():
                if times > 1:
                    self.wrong(f"{job} wrote {times} times")
            written = [fact.value for fact in facts if fact.validity is m.Validity.VALID]
            if len(set(written)) != len(written):
                self.wrong(f"a primitive is written twice: {written}")
            moved = [p for p in self.ledger.begun if self._arm_of(p) == arm]
            last = facts[-1] if facts else None
            if moved and (last is None or (last.validity is m.Validity.VALID and last.value != moved[-1])):
                self.wrong(f"{arm} did {moved[-1]} last, and the world trusts {last and last.value}")
            for record in self.records.values():
                if record.outcome and record.outcome.kind is OutcomeKind.SUCCEEDED:
                    mine = [p for p in self.ledger.of(record.command) if f" {arm.partition('-')[0]} " in record.text]
                    if [p for p in written if p in mine] != mine:
                        self.wrong(f"{record.command} did {mine}, written is {written}")

    def _arm_of(self, primitive: str) -> str:
        record = self.records.get(primitive.partition(".")[0])
        return f"{record.text.split()[1]}-ARM" if record else ""

    def wrong(self, what: str) -> None:
        self.log(f"!! {what}")
        self.problems.append(what)

    def log(self, what: str) -> None:
        if self.log_line:
            self.log_line(f"{self.clock.now_s - network.START_S:9.4f}  {what}")


def _in_words(event: Event) -> str:
    fields = msgspec.structs.asdict(event)
    shown = {
        k: v for k, v in fields.items() if k not in ("at_s", "product", "report", "took_s") and v not in ("", [], None)
    }
    if (report := fields.get("report")) is not None:
        shown |= {"primitive": report.primitive, "reason": report.reason.value}
    return f"{type(event).__name__} {' '.join(f'{k}={v}' for k, v in shown.items())}"
