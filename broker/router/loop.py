"""The broker's shell: sockets, journal and clock round the Decision Unit. It turns bytes into events and effects into
bytes, and decides nothing.

Every turn of the loop reads the sockets in order of priority: halts, subsystems, supervisor, workers, clients. Halts
are a turn of their own: decided, journalled and sent before anything else is even read. A turn is short, however much
lies waiting, so that the next halt is soon seen. The events of a turn are journalled in one transaction before any of
its effects goes out (invariant 7).
"""

from __future__ import annotations

import os
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from typing import Any

import msgspec
import zmq

from broker.decisions import effects as do
from broker.decisions import events as heard
from broker.decisions import reporting
from broker.decisions.decide import MAX_TEXT, decide
from broker.decisions.state import Link, State, request_key
from broker.dispatch.autoscaler import Autoscaler
from broker.dispatch.timers import Timers
from broker.dispatch.worker_registry import LostJob, WorkerRegistry
from broker.persistence.journal import Journal, number
from broker.persistence.program_loads import ProgramLoads
from broker.persistence.program_store import ProgramStore
from broker.router.outbox import Outbox
from broker.router.queries import status
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason, WireError
from rtc.protocol.primitive_id import command_of
from rtc.runtime.halt_admission import HaltRateLimiter, read_order
from rtc.runtime.handover import TOKEN_BEARERS, Handed
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Every, Process, inbox, send
from rtc.runtime.settings import BOUNDS, NO_HANDOVER, Settings
from rtc.world.lease import sign

# A turn reads from a socket until it has heard of so many events; the shares are those of a stream of short commands,
# so that none of them has to wait for long (workers tell several results in a message).
EVENTS_PER_TURN = {"halt": 10, "subsystems": 16, "workers": 48, "front": 64}
MESSAGES_PER_TURN = 200  # of those that are no events
READ_S = 0.003  # and no longer than this: what is asked, long, or no message at all costs time too
QUESTIONS_PER_S = 100  # of one client: answers are long, and wait in our memory for who does not fetch them
LOAD_QUESTIONS = 20  # a program that is loaded counts as so many
SUBSYSTEM_SILENCE_S = 2.0
SUBSYSTEM_DEAF_S = 5.0  # one that is lost for so long, and runs, is started anew
ALONE_S = 1.2  # for the outcomes of all commands when the supervisor has died; at full speed
CLIENT_SILENCE_S = 5.0  # of one that is watched
STOOD_STILL_S = 1.0  # between two turns of ours: we were stopped, or the machine was
LOOK_S = 0.02  # whether a program is checked
SNAPSHOT_EVENTS = 30_000  # decided again in well under a second by a restarted broker
SNAPSHOT_S, WORTH_A_SNAPSHOT = 10.0, 2_000  # and this many events after so long, for a restart in a moment
#: who says at the supervisor's door how many messages it has dropped -> which counts are its own
TELL_DROPPED: dict[bytes, tuple[str, ...]] = {
    b"world": ("world",),
    b"gate": ("gate_strangers", "gate_unreadable", "gate_refused", "gate_nameless", "gate_unsent"),
}
CALLERS_KEPT = 200  # who are told what becomes of their halts: of the last HALTS_OF_CALLER of each
HALTS_OF_CALLER = 8


class Router:
    def __init__(
        self,
        me: Process,
        settings: Settings,
        journal: Journal,
        state: State,
        store: ProgramStore,
        given: Handed,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock  # CLOCK_MONOTONIC, or that of a simulated cluster
        self.me, self.settings, self.journal, self.state = me, settings, journal, state
        self.store, self.given, self.lease_key = store, given, given.lease_key
        self._supervisor_peer = _peer(given.identity("supervisor"))
        self.loads = ProgramLoads(store)
        self.registry = WorkerRegistry()
        self._autoscaler = Autoscaler(settings.least, settings.most_workers)
        self.timers = Timers()
        self.dropped: Counter[str] = Counter()  # messages nobody could read, or from who may not say such; by socket
        self.told_dropped: dict[str, int] = {}  # the same by other processes' sockets, as they tell
        self.processes: list[dict[str, Any]] = []  # as the supervisor told last,
        self.processes_at_s = self._clock()  # and when
        self.turn_times_s: deque[float] = deque(maxlen=4096)
        self.began_s = self._turn_at_s = self._clock()
        self._halt_limiter = HaltRateLimiter()
        self._life = f"{self.began_s * 1e6:.0f}"  # of this broker: another one begins to count again
        self._end_halt = f"end-{self._life}"  # when the cluster is stopped
        self._halts_called = 0
        self._halts_of: OrderedDict[bytes, deque[tuple[str, m.HaltOrder]]] = OrderedDict()  # by caller
        self._subsystem_heard_s: dict[str, float] = {}
        # Clients with commands that are halted when they go away; when each was heard last.
        self._watched_s = {c.client: self.began_s for c in state.commands.values() if c.halt_if_lost}
        self._supervisor = False
        self._ending: list[str] | None = None  # commands that were live when the cluster was told to end
        self._arms_at_end: set[str] = set()  # that were in motion then
        self._topics: set[bytes] = set()  # that somebody listens to: beginnings of all that is published
        self._asked: Counter[bytes] = Counter()  # questions of a client in this second
        self._second = Every(1.0)
        self._reports: Counter[str] = Counter()  # periodic reports forwarded to a client in this second
        self._reports_second = Every(1.0)
        self._audit = Every(0.1)
        self._snapshots = Every(SNAPSHOT_S)
        self.guard: MemoryGuard | None = None  # of this process's memory; none in a simulation
        self._socket: dict[str, zmq.Socket[bytes]] = {}
        for name in ("halt", "subsystems", "supervisor", "workers", "front"):
            self._socket[name] = me.socket(
                zmq.ROUTER, settings.endpoint(name), bind=True, bounds=BOUNDS[name], handover=name not in NO_HANDOVER
            )
        self._socket["events"] = me.socket(zmq.XPUB, settings.endpoint("events"), bind=True, bounds=BOUNDS["events"])
        self._outbox = {name: Outbox(partial(self._socket.__getitem__, name)) for name in ("front", "subsystems")}
        self._events: list[heard.Event] = []
        self._perform = {kind: partial(perform, self) for kind, perform in _PERFORM.items()}

    # --- the loop -------------------------------------------------------------------------------------

    def run(self) -> None:
        while not self.me.stopping:
            self.turn(self.me.wait(self._wait_s()))
        if self.me.orphaned:
            self._end_alone()
        else:
            self.journal.snapshot(self.state)

    def _wait_s(self) -> float:
        now = self._clock()
        next_s = now + LOOK_S if self.loads.busy else None
        if (timer_s := self.timers.next_at_s()) is not None:
            next_s = timer_s if next_s is None else min(timer_s, next_s)
        return min(self._audit.left_s(now), max(0.0, next_s - now) if next_s is not None else 1.0)

    def turn(self, readable: Collection[Any] | None = None) -> None:
        """Hear and settle once. `readable`: the sockets that have something to read; None: look at all."""
        began = self._clock()
        waiting = [n for n, socket in self._socket.items() if readable is None or socket in readable]
        if "halt" in waiting:
            self._read("halt", began)
        if (merged := self._halt_limiter.due(began)) is not None:
            self._events.append(_halt_called("", merged, began))
        if self._events:
            self._settle(began)
        reports_heard = True
        for name in waiting:
            if name == "events":
                self._hear_subscriptions(began)
            elif name != "halt":
                all_read = self._read(name, began)
                reports_heard &= all_read or name != "subsystems"
        if reports_heard:  # or what a timer waits for may be lying there
            self._events += [heard.TimerFired(at_s=began, timer=name) for name in self.timers.due(began)]
        stood_still = began - self._turn_at_s > STOOD_STILL_S  # then nobody else is to blame for silence
        self._turn_at_s = began
        if self.loads.busy:
            self._put_into_use(began)
        if self._audit.due(began) and not stood_still:
            self._look_after(began)
        if self._events:
            self._settle(began)
            self._tell_all_ended()
            self.turn_times_s.append(self._clock() - began)
        else:
            self._give_out(began)

    def _settle(self, now: float) -> None:
        """Decide about all events of this turn, journal them, then do what was decided."""
        events, self._events = self._events, []
        effects: list[do.Effect] = []
        for event in events:
            effects += decide(self.state, event)
        self.journal.append(events, [e.record for e in effects if type(e) is do.ReportEnd])
        perform = self._perform
        for effect in effects:
            perform[type(effect)](effect)
        for outbox in self._outbox.values():
            outbox.flush()
        self._give_out(now)
        if self.journal.events_since_snapshot >= SNAPSHOT_EVENTS:
            self.journal.snapshot(self.state)

    def hear(self, event: heard.Event) -> None:
        """An event that comes from nobody's socket: start-up."""
        self._events.append(event)

    def _read(self, name: str, now: float) -> bool:
        """What lies on one socket, as far as there is room in this turn. False: there may be more."""
        most = EVENTS_PER_TURN.get(name, MESSAGES_PER_TURN)
        messages, began = 0, self._clock()
        for peer, *parts in inbox(self._socket[name], MESSAGES_PER_TURN):
            messages += 1
            self._take(name, peer, parts, now)
            if len(self._events) >= most or self._clock() - began > READ_S:
                return False
        return messages < MESSAGES_PER_TURN

    def _take(self, name: str, peer: bytes, parts: Sequence[bytes], now: float) -> None:
        """One message, or an array of them. A bad one among these is dropped alone."""
        read, take = _DOORS[name]
        try:
            messages = read(parts)
        except WireError as error:
            alone = wire.apart(parts)
            if len(alone) < 2:
                self._drop(name, peer, parts, error)
            for one in alone if len(alone) > 1 else ():
                self._take(name, peer, one, now)
            return
        for message in messages:
            try:
                take(self, peer, message, now)
            except WireError as error:
                self._drop(name, peer, parts, error)

    def _drop(self, name: str, peer: bytes, parts: Sequence[bytes], error: WireError) -> None:
        self.dropped[name] += 1
        if self.dropped[name] <= 20 or self.dropped[name] % 1000 == 0:
            self.me.log.warning("dropped a message on %s from %r: %s", name, peer[:40], error)
        if name in ("front", "halt"):
            refusal = Refusal(reason=RefusalReason.SENTENCE, message=f"no message of this protocol: {error}")
            send(self._socket[name], m.Declined(request=wire.name_in(parts), refusal=refusal), peer)

    def _hear_subscriptions(self, now: float) -> None:
        """One frame each: 1 or 0, and the beginning of what is wanted. Anything else is somebody's noise."""
        before = bool(self._topics)
        for frame, *_ in inbox(self._socket["events"], MESSAGES_PER_TURN):
            wanted, topic = frame[:1], frame[1:]
            if wanted not in (b"\0", b"\1") or not wire.PROTOCOL.startswith(topic):
                self.dropped["events"] += 1
            elif wanted == b"\1":
                self._topics.add(topic)
            else:
                self._topics.discard(topic)
        self._tell_listeners(before, now)

    def _tell_listeners(self, before: bool, now: float) -> None:
        if before is not bool(self._topics):
            self._events.append(heard.ListenersChanged(at_s=now, listening=bool(self._topics)))

    # --- bytes into events ----------------------------------------------------------------------------

    def _from_halt(self, peer: bytes, order: m.HaltOrder, now: float) -> None:
        self._halts_called += 1  # each order has a number of its own: names may be used again
        called, order = order, msgspec.structs.replace(order, call=f"{self._life}-{self._halts_called}")
        if self._halt_limiter.exceeds(peer, now):
            self._halt_limiter.merge(order)
            self.dropped["halts_folded"] += 1
            return
        self._halts_of.setdefault(peer, deque(maxlen=HALTS_OF_CALLER)).append((order.call, called))
        self._halts_of.move_to_end(peer)
        if len(self._halts_of) > CALLERS_KEPT:
            self._halts_of.popitem(last=False)
        self._events.append(_halt_called(_name(peer), order, now))

    def _subsystem_name(self, peer: bytes, message: Any) -> str:
        """The name of the subsystem behind a peer. Raises WireError for a stranger that uses the name of one of ours:
        its identity lacks the token. It is refused in words when it introduces itself."""
        name = _name(peer)
        bare = name.removesuffix(f"@{self.given.token}")
        if bare not in TOKEN_BEARERS or name == self.given.identity(bare):
            return bare
        if isinstance(message, m.SubsystemHello):
            ours = self.state.subsystems.get(bare)
            words = f"this cluster has its own {bare}" + (f", pid {ours.pid}" if ours else "")
            refusal = Refusal(reason=RefusalReason.NOT_ALLOWED, message=words, clears="use another name")
            send(self._socket["subsystems"], m.Declined(request=bare, refusal=refusal), peer)
        raise WireError(f"a stranger uses the name {bare}")

    def _subsystem_peer(self, name: str) -> bytes:
        return _peer(self.given.identity(name))

    def _from_subsystem(self, peer: bytes, message: Any, now: float) -> None:
        name = self._subsystem_name(peer, message)
        if isinstance(message, m.SubsystemHello) or name in self.state.subsystems:
            self._subsystem_heard_s[name] = now
        match message:
            case m.SubsystemHello(name=other) | m.HaltStarted(subsystem=other) | m.HaltAtRest(subsystem=other) if (
                other != name
            ):
                raise WireError(f"{name!r:.80} speaks for {other!r:.80}")
            case m.EndReport():
                self._events.append(heard.PrimitiveEnded(at_s=now, subsystem=name, report=message))
            case m.Started():
                self._events.append(heard.PrimitiveStarted(at_s=now, subsystem=name, primitive=message.primitive))
            case m.HaltStarted():
                self._tell_halt_callers(message)
                if message.halt == self._end_halt:
                    self._arms_at_end.update(message.moving)
            case m.HaltAtRest():
                self._tell_halt_callers(message)
                self._events.append(
                    heard.HaltConfirmed(
                        at_s=now,
                        subsystem=name,
                        halt=message.halt,
                        at_rest=message.at_rest,
                        performers=message.performers,
                    )
                )
            case m.HaltOrder():
                self._events.append(_halt_called(name, message, now))
            case m.SubsystemHello():
                self._outbox["subsystems"].set_arrays(peer, message.arrays)
                self.me.log.info("%.80r is here, pid %d, %.200s", name, message.pid, message.performers)
                self._events.append(
                    heard.SubsystemConnected(
                        at_s=now,
                        subsystem=name,
                        pid=message.pid,
                        performers=message.performers,
                        outstanding=message.outstanding,
                        at_rest=message.at_rest,
                    )
                )
            case m.Heartbeat():
                known = self.state.subsystems.get(name)
                if known is None or known.link is not Link.CONNECTED:
                    send(self._socket["subsystems"], m.ReportAck(primitive=""), peer)
            case m.Dropped():
                self._count_dropped(message, ("estop", "bench"))
            case m.ProgressReport():
                self._forward(name, message, now)

    def _forward(self, subsystem: str, report: m.ProgressReport, now: float) -> None:
        """A report of REPORT EVERY goes straight to the client that gave the command: no event, and not journalled."""
        command = self.state.commands.get(command_of(report.primitive))
        if command is None or not reporting.wants_periodic(command, report, subsystem):
            return
        if self._reports_second.due(now):
            self._reports.clear()
        self._reports[command.client] += 1
        if self._reports[command.client] > reporting.MOST_PER_S:
            self.dropped["reports"] += 1
            return
        self._outbox["front"].send_now(_peer(command.client), reporting.periodic(command, report, now))

    def _from_supervisor(self, peer: bytes, message: Any, now: float) -> None:
        if isinstance(message, m.Dropped) and peer in TELL_DROPPED:
            self._count_dropped(message, TELL_DROPPED[peer])
            return
        if peer != self._supervisor_peer or isinstance(message, m.Dropped):
            raise WireError("somebody who is not the supervisor")
        self._supervisor = True
        match message:
            case m.ProcessExited():
                self.me.log.warning("%.80r (pid %d) ended with status %d", message.name, message.pid, message.status)
                worker = self.registry.workers.get(message.name)
                if worker is not None and worker.pid == message.pid:
                    self._lose(message.name, self.registry.remove(message.name), f"exit status {message.status}", now)
                subsystem = self.state.subsystems.get(message.name)
                if subsystem is not None and subsystem.pid == message.pid:
                    why = f"its process ended with status {message.status}"
                    self._events.append(heard.SubsystemGone(at_s=now, subsystem=message.name, why=why))
            case m.Shutdown():
                self._end_all(now)
            case m.ProcessTable():
                self.processes = [dict(row) for row in message.processes]
                self.processes_at_s = now

    def _end_all(self, now: float) -> None:
        """The cluster is being stopped: halt everything, and tell the supervisor when every command has ended."""
        if self._ending is None:
            self.me.log.info("the cluster is being stopped; %d commands are live", len(self.state.commands))
            self._ending = list(self.state.commands)
            order = m.HaltOrder(halt=self._end_halt, called_at_s=now)
            self._events.append(_halt_called("supervisor", order, now))
        else:
            self._tell_all_ended()

    def _end_alone(self) -> None:
        """The supervisor has died: halt everything, and send every client its outcomes. The MCM brakes by itself and
        reports; the workers are dead, so no last analysis is waited for. Nobody goes on with this journal."""
        limit_s = self._clock() + ALONE_S * self.settings.timeout_scale
        self._end_all(self._clock())
        self.turn()
        while self.state.commands and (left_s := limit_s - self._clock()) > 0.0:
            self._give_up_analyses()
            self.turn(self.me.wait(0.0 if self._events else min(left_s, self._wait_s())))
        if self.state.commands:
            why, now = "it gave no report after the supervisor's death", self._clock()
            self._events += [heard.SubsystemGone(at_s=now, subsystem=name, why=why) for name in self.state.subsystems]
            self.turn(())
            self._give_up_analyses()
            self.turn(())

    def _give_up_analyses(self) -> None:
        refusal = Refusal(reason=RefusalReason.TIMEOUT, message="the workers have died with the supervisor")
        self._events += [
            heard.JobDeclined(
                at_s=self._clock(), job=command.job.id, attempt=command.job.attempt, node="broker", refusal=refusal
            )
            for command in self.state.commands.values()
            if command.job is not None
        ]

    def _tell_all_ended(self) -> None:
        if self._ending is not None and not self.state.commands:
            ended = m.AllEnded(commands=self._ending, arms=sorted(self._arms_at_end))
            send(self._socket["supervisor"], ended, self._supervisor_peer)

    def _count_dropped(self, message: m.Dropped, sockets: Collection[str]) -> None:
        self.told_dropped.update((name, n) for name, n in message.counts.items() if name in sockets)

    def _from_worker(self, peer: bytes, message: Any, now: float) -> None:
        name = _name(peer)
        match message:
            case m.ResultBatch():
                known = self.registry.mark_alive(name, now)
                for result in message.results:
                    # What was not given to this worker, or not any more, is nobody's answer.
                    if self.registry.answered(name, result.id, result.attempt, getattr(result, "took_s", 0.0), now):
                        self._events.append(_result(name, result, now))
                    else:
                        self.dropped["results"] += 1
                if not known:
                    send(self._socket["workers"], m.JobBatch(jobs=[]), peer)
            case m.Heartbeat():
                if not self.registry.mark_alive(name, now):
                    send(self._socket["workers"], m.JobBatch(jobs=[]), peer)  # who are you? say hello
            case m.WorkerHello(name=other) if other != name:
                raise WireError(f"{name!r:.80} says it is {other!r:.80}")
            case m.WorkerHello():
                lost = self.registry.register(name, message.node, message.kind, message.pid, now)
                self._lose(name, lost, "its process was replaced", now)
            case m.WorkerGone(name=other) if other != name:
                raise WireError(f"{name!r:.80} says that {other!r:.80} is gone")
            case m.WorkerGone():
                self._lose(name, self.registry.remove(name), "its connection was lost", now)
            case m.ProgramWanted():
                body = self.store.body(message.digest)
                send(self._socket["workers"], m.ProgramBody(digest=message.digest, body=body), peer)

    def _lose(self, name: str, lost: Iterable[LostJob], why: str, now: float) -> None:
        for job, in_hand in lost:
            self._events.append(
                heard.JobLost(at_s=now, job=job.job, attempt=job.attempt, node=name, evidence=why, blamed=in_hand)
            )

    def _from_client(self, peer: bytes, message: Any, now: float) -> None:
        if isinstance(message, _QUESTIONS) and self._asks_too_much(peer, message, now):
            return
        if isinstance(message, _MEANT_FOR_ONE) and message.cluster not in ("", self.settings.run):
            self._decline_anothers(peer, message)
            return
        match message:
            case m.CommandText() if known := self._another_sentence(peer, message):
                words = f"the request {message.request} was another sentence before, {known}; nothing is done"
                clears = "give each sentence a request of its own"
                refusal = Refusal(reason=RefusalReason.STATE, message=words, clears=clears)
                self._answer(peer, m.Declined(request=message.request, refusal=refusal))
            case m.CommandText() if self._ending is not None and not self._is_known(peer, message):
                refusal = Refusal(reason=RefusalReason.STATE, message="the cluster is being stopped", clears="rtc up")
                self._answer(peer, m.Declined(request=message.request, refusal=refusal))
            case m.CommandText():
                if message.halt_if_lost:
                    self._watched_s[_name(peer)] = now
                self._events.append(
                    heard.CommandReceived(
                        at_s=now,
                        client=_name(peer),
                        request=message.request,
                        text=message.text[:MAX_TEXT],
                        source=message.source,
                        progress=message.progress,
                        halt_if_lost=message.halt_if_lost,
                        sent_at_s=message.sent_at_s,
                        known_as=message.known_as,
                    )
                )
            case m.Heartbeat(name=name):
                if name in self._watched_s:
                    self._watched_s[name] = now
            case m.ClientHello():
                self._outbox["front"].set_arrays(peer, message.arrays)
                self._welcome(peer)
            case m.StatusQuery():
                self._answer(peer, m.StatusReply(request=message.request, status=status(self)))
            case m.TraceQuery():
                self._answer(peer, self._trace(message))
            case m.ProgramQuery():
                digest = self.state.programs.get(message.kind, "")
                body = self.store.body(digest) or b""
                self._answer(peer, m.ProgramReply(request=message.request, kind=message.kind, digest=digest, body=body))
            case m.ProgramText():
                if (too_many := self.loads.add(peer, message)) is not None:
                    self._answer(peer, m.Declined(request=message.request, refusal=too_many))
            case m.Shutdown():
                self.me.log.info("told to shut the cluster down")
                send(self._socket["supervisor"], m.Shutdown(request=message.request), self._supervisor_peer)

    def _asks_too_much(self, peer: bytes, message: Any, now: float) -> bool:
        if self._second.due(now):
            self._asked.clear()
        self._asked[peer] += LOAD_QUESTIONS if isinstance(message, m.ProgramText) else 1
        if self._asked[peer] <= QUESTIONS_PER_S:
            return False
        self.dropped["questions"] += 1
        words = f"a client may ask {QUESTIONS_PER_S} times a second; a program counts as {LOAD_QUESTIONS}"
        refusal = Refusal(reason=RefusalReason.OVERLOAD, message=words, clears="ask again a second later")
        self._answer(peer, m.Declined(request=message.request, refusal=refusal))
        return True

    def _is_known(self, peer: bytes, message: m.CommandText) -> bool:
        return request_key(_name(peer), message.request) in self.state.requests

    def _another_sentence(self, peer: bytes, message: m.CommandText) -> str:
        """The command that this request is already, if that has another text: a client that counts from one again has
        no use for the answers of its former life."""
        command = self.state.requests.get(request_key(_name(peer), message.request), "")
        if (live := self.state.commands.get(command)) is not None:
            text = live.text
        elif (ended := self.state.ended.get(command)) is not None:
            text = _read_ended(ended.message).text
        else:
            return ""
        return command if text != message.text[:MAX_TEXT] else ""

    def _welcome(self, peer: bytes) -> None:
        self._answer(peer, m.Welcome(cluster=self.settings.run, pid=os.getpid(), arrays=True))

    def _decline_anothers(self, peer: bytes, message: m.CommandText | m.ProgramText) -> None:
        """What was said to a cluster that was here before us must not move anything now. First who we are, so that
        whoever waits for that one's answers knows that none will come."""
        self.dropped["for_another_cluster"] += 1
        self._welcome(peer)
        words = f"meant for the cluster {message.cluster}, which is gone; this is {self.settings.run or 'another'}"
        refusal = Refusal(
            reason=RefusalReason.STATE,
            message=words,
            clears="connect again, and give it again if it is meant for this one",
        )
        self._answer(peer, m.Declined(request=message.request, refusal=refusal))

    def _answer(self, peer: bytes, message: m.BrokerToClient) -> None:
        self._outbox["front"].send_now(peer, message)

    def _trace(self, query: m.TraceQuery) -> m.TraceReply | m.Declined:
        live = self.state.commands.get(query.command)
        if live is not None:
            record = m.CommandRecord(
                command=live.id,
                text=live.text,
                source=live.source,
                request=live.request,
                accepted_at_s=live.accepted_at_s,
                phase=live.phase,
                notes=live.notes,
            )
            return m.TraceReply(request=query.request, record=record)
        if (story := self.journal.story(query.command)) is not None:
            return m.TraceReply(request=query.request, record=story)
        if self.state.lost and 0 < number(query.command) <= self.state.accepted:
            message = f"{query.command} is not in the journal: {self.state.lost}"
            return m.Declined(request=query.request, refusal=Refusal(reason=RefusalReason.NAME, message=message))
        last = f"the last one accepted is C-{self.state.accepted}" if self.state.accepted else "none was accepted yet"
        message = f"there is no command {query.command}; {last}"
        return m.Declined(request=query.request, refusal=Refusal(reason=RefusalReason.NAME, message=message))

    def _put_into_use(self, now: float) -> None:
        """Programs whose check is done. One that checks is decided and journalled before its client is told."""
        for peer, text, loaded in self.loads.poll(now):
            answer: m.ProgramLoaded | m.Declined
            if isinstance(loaded, Refusal):
                answer = m.Declined(request=text.request, refusal=loaded)
            else:
                self._events.append(
                    heard.ProgramInstalled(at_s=now, kind=text.kind, digest=loaded.digest, file=text.name)
                )
                self._settle(now)
                changes = loaded.changes
                answer = m.ProgramLoaded(request=text.request, kind=text.kind, digest=loaded.digest, changes=changes)
            self._answer(peer, answer)

    # --- what only the clock tells --------------------------------------------------------------------

    def _look_after(self, now: float) -> None:
        if self.guard is not None and (stage := self.guard.alarm(now)):
            self._open_anew(stage, now)
        self.journal.tidy()
        if self._snapshots.due(now) and self.journal.events_since_snapshot >= WORTH_A_SNAPSHOT:
            self.journal.snapshot(self.state)
        for worker, why in self.registry.hung(now):
            self.me.log.warning("%s (pid %d) %s", worker.name, worker.pid, why)
            send(
                self._socket["supervisor"],
                m.KillProcess(name=worker.name, pid=worker.pid, why=why),
                self._supervisor_peer,
            )
            self._lose(worker.name, self.registry.remove(worker.name), why, now)
        for process in self.processes:
            ready_since_s = max(self.began_s, process.get("since_s", now))
            if process.get("state") == "ready" and self.registry.never_registered(process["name"], ready_since_s, now):
                why = "hung: it has not said a word to this broker"
                self.me.log.warning("%s (pid %d) %s", process["name"], process["pid"], why)
                process["state"] = "hung"
                send(
                    self._socket["supervisor"],
                    m.KillProcess(name=process["name"], pid=process["pid"], why=why),
                    self._supervisor_peer,
                )
        if self._supervisor:
            for order in self._autoscaler.orders(self.registry, self.processes, now):
                self.me.log.info("%s", order)
                send(self._socket["supervisor"], order, self._supervisor_peer)
        for job in self.registry.waited_too_long(now):
            message = f"no {job.kind.value} took the job within the limit; is one alive? see `rtc status`"
            refusal = Refusal(reason=RefusalReason.TIMEOUT, message=message)
            self._events.append(
                heard.JobDeclined(at_s=now, job=job.job, attempt=job.attempt, node="broker", refusal=refusal)
            )
        for name in [name for name, heard_s in self._watched_s.items() if now - heard_s > CLIENT_SILENCE_S]:
            del self._watched_s[name]
            self._events.append(heard.ClientGone(at_s=now, client=name))
        for name in self._subsystem_heard_s.keys() - self.state.subsystems.keys():
            del self._subsystem_heard_s[name]
        for name, subsystem in self.state.subsystems.items():
            silent_s = now - self._subsystem_heard_s.get(name, self.began_s)
            if subsystem.link is not Link.LOST and silent_s > SUBSYSTEM_SILENCE_S:
                why = f"silent for {silent_s:.1f} s"
                self._events.append(heard.SubsystemGone(at_s=now, subsystem=name, why=why))
            elif subsystem.link is Link.LOST and silent_s > SUBSYSTEM_DEAF_S:
                self._replace_deaf(name, subsystem.pid, silent_s, now)

    def _replace_deaf(self, name: str, pid: int, silent_s: float, now: float) -> None:
        """A subsystem that is lost to us although its process lives: the supervisor starts it anew."""
        for row in self.processes:
            if row["name"] == name and row["pid"] == pid and row.get("state") == "ready":
                self._subsystem_heard_s[name] = now  # ask once per period
                why = f"lost to the broker for {silent_s:.1f} s, although it runs"
                self.me.log.warning("%s (pid %d) %s", name, pid, why)
                order = m.KillProcess(name=name, pid=pid, why=why)
                send(self._socket["supervisor"], order, self._supervisor_peer)

    def _open_anew(self, stage: int, now: float) -> None:
        """Somebody has filled our memory. Whoever belongs here comes back, and says again what was not answered."""
        assert self.guard is not None
        doors = ("front", "halt") if stage == 1 else ("events", "supervisor", "workers", "subsystems")
        self.me.log.warning("more than %.0f MB: opening %s anew", self.guard.limit_mb, ", ".join(doors))
        for name in doors:
            self._socket[name] = self.me.open_anew(
                self._socket[name], self.settings.endpoint(name), BOUNDS[name], handover=name not in NO_HANDOVER
            )
        if "events" in doors:
            before = bool(self._topics)
            self._topics.clear()
            self._tell_listeners(before, now)
        if "workers" in doors:  # jobs may have been on their way
            for worker in list(self.registry.workers):
                lost = [LostJob(job, in_hand=False) for job, _ in self.registry.remove(worker)]
                self._lose(worker, lost, "its connection was cut", now)

    # --- effects into bytes ---------------------------------------------------------------------------

    def _give_out(self, now: float) -> None:
        for worker, jobs in self.registry.assign(now):
            batch = [
                m.Job(
                    id=job.job,
                    attempt=job.attempt,
                    program=job.program,
                    cell=job.cell,
                    input=job.input,
                    lease=None if not job.locations else sign(self.lease_key, job.job, job.locations),
                )
                for job in jobs
            ]
            if not send(self._socket["workers"], m.JobBatch(jobs=batch), _peer(worker)):
                self._lose(worker, self.registry.remove(worker), "its connection is gone", now)

    def _dispatch(self, effect: do.DispatchJob) -> None:
        command = self.state.commands.get(effect.job.partition("/")[0])
        self.registry.submit(effect, self._clock(), command.client if command else "")

    def _cancel(self, effect: do.CancelJob) -> None:
        if worker := self.registry.cancel(effect.job):
            send(self._socket["workers"], m.Drop(jobs=[effect.job]), _peer(worker))

    def _send_primitive(self, effect: do.SendPrimitive) -> None:
        message = {
            "type": "Execute",
            "primitive": effect.primitive,
            "issued_at_s": effect.issued_at_s,
            "pid": effect.pid,
        }
        self._outbox["subsystems"].put(self._subsystem_peer(effect.subsystem), message)

    def _send_halt(self, effect: do.SendHalt) -> None:
        order = m.HaltOrder(halt=effect.halt, scope=effect.scope, called_at_s=effect.called_at_s, call=effect.call)
        self._outbox["subsystems"].send_now(self._subsystem_peer(effect.subsystem), order)

    def _acknowledge(self, effect: do.AcknowledgeReport) -> None:
        self._outbox["subsystems"].put(self._subsystem_peer(effect.subsystem), m.ReportAck(primitive=effect.primitive))

    def _start_timer(self, effect: do.StartTimer) -> None:
        self.timers.start(effect.timer, effect.at_s)

    def _stop_timer(self, effect: do.StopTimer) -> None:
        self.timers.stop(effect.timer)

    def _tell(self, effect: do.TellClient) -> None:
        self._outbox["front"].put(_peer(effect.client), effect.message)

    def _publish(self, effect: do.PublishNote) -> None:
        if effect.client:
            self._outbox["front"].put(_peer(effect.client), effect.note)
        if self._topics:
            send(self._socket["events"], effect.note)

    def _report_end(self, effect: do.ReportEnd) -> None:
        kept = self.state.ended.get(effect.ended.command)
        encoded = kept.message if kept else effect.ended  # once is enough
        self._outbox["front"].put(_peer(effect.client), encoded)
        if self._topics:
            send(self._socket["events"], encoded)

    def _decline_halt(self, effect: do.DeclineHalt) -> None:
        refusal = Refusal(reason=RefusalReason.NAME, message=effect.message)
        send(self._socket["halt"], m.Declined(request=effect.halt, refusal=refusal), _peer(effect.client))

    def _tell_halt_callers(self, message: m.HaltStarted | m.HaltAtRest) -> None:
        """Who called it; by name, when the subsystem does not repeat which order it answers."""
        for peer, called in self._halts_of.items():
            for call, order in called:
                if message.call == call or (not message.call and message.halt == order.halt):
                    send(self._socket["halt"], msgspec.structs.replace(message, call=order.call), peer)


def _halt_called(client: str, order: m.HaltOrder, now: float) -> heard.HaltCalled:
    return heard.HaltCalled(
        at_s=now,
        client=client,
        halt=order.halt,
        scope=order.scope,
        called_at_s=order.called_at_s,
        call=order.call,
        received_at_s=order.received_at_s,
    )


def _result(node: str, result: m.JobResult, now: float) -> heard.Event:
    match result:
        case m.JobDone():
            return heard.JobFinished(
                at_s=now,
                job=result.id,
                attempt=result.attempt,
                node=node,
                product=result.product,
                took_s=result.took_s,
            )
        case m.JobRefused():
            return heard.JobDeclined(at_s=now, job=result.id, attempt=result.attempt, node=node, refusal=result.refusal)
        case m.JobCrashed():
            return heard.JobLost(at_s=now, job=result.id, attempt=result.attempt, node=node, evidence=result.evidence)


def _name(peer: bytes) -> str:
    """A routing identity as text, and back by `_peer`; any bytes survive."""
    return peer.decode("latin-1")


def _peer(name: str) -> bytes:
    return name.encode("latin-1")


_read_ended = wire.decoder(m.CommandEnded)
_QUESTIONS = (m.StatusQuery, m.TraceQuery, m.ProgramQuery, m.ProgramText)
_MEANT_FOR_ONE = (m.CommandText, m.ProgramText)
#: socket -> how its messages are read, and who takes them
_DOORS: dict[str, tuple[Callable[[Any], Any], Callable[[Router, bytes, Any, float], None]]] = {
    "halt": (lambda parts: (read_order(parts),), Router._from_halt),
    "subsystems": (wire.reader_of_many(m.SubsystemToBroker), Router._from_subsystem),
    "supervisor": (wire.reader_of_many(m.SupervisorToBroker), Router._from_supervisor),
    "workers": (wire.reader_of_many(m.WorkerToBroker), Router._from_worker),
    "front": (wire.reader_of_many(m.ClientToBroker), Router._from_client),
}

_PERFORM: dict[type[do.Effect], Callable[[Router, Any], None]] = {
    do.DispatchJob: Router._dispatch,
    do.CancelJob: Router._cancel,
    do.SendPrimitive: Router._send_primitive,
    do.SendHalt: Router._send_halt,
    do.AcknowledgeReport: Router._acknowledge,
    do.StartTimer: Router._start_timer,
    do.StopTimer: Router._stop_timer,
    do.TellClient: Router._tell,
    do.PublishNote: Router._publish,
    do.ReportEnd: Router._report_end,
    do.DeclineHalt: Router._decline_halt,
}
