"""Messages of clients: sentences, queries, programs to load, the order to end the cluster."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import msgspec

from broker.decisions import program_rollout
from broker.decisions.decide import MAX_TEXT
from broker.decisions.events import BreakpointsChanged, CommandReceived, StepRequested
from broker.decisions.state import request_key
from broker.router.breakpoints import ProgramBodies, refusal_of
from broker.router.core import Core, name_of
from broker.router.egress import Egress
from broker.router.health import Health
from broker.router.queries import status, trace
from broker.router.shutdown import ClusterShutdown
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.runtime.allowance import Allowance

QUERIES_PER_S = 100  # of one client: replies are large, and are buffered while the client does not read
CELL = "cell"  # its place among the programs
LOAD_QUERIES = 20  # a program to load counts as so many queries
GREETED = 10_000  # clients whose hello is remembered
QUERIES = frozenset([m.StatusQuery, m.TraceQuery, m.ProgramQuery, m.ProgramText, m.SetBreakpoints, m.StepCommand])
MEANT_FOR_ONE = frozenset([m.CommandText, m.ProgramText])  # they name the cluster that they are meant for

read_ended = wire.decoder(m.CommandEnded)


class ClientMessages:
    def __init__(self, core: Core, egress: Egress, health: Health, shutdown: ClusterShutdown) -> None:
        self._core, self._egress, self._health, self._shutdown = core, egress, health, shutdown
        self._queries = Allowance(QUERIES_PER_S)  # of each client
        self._greeted: OrderedDict[bytes, None] = OrderedDict()  # clients with a hello to this broker

    def receive(self, peer: bytes, message: Any, now: float) -> None:
        kind = type(message)
        if kind in QUERIES and self._exceeds_rate(peer, message, now):
            return
        if kind in MEANT_FOR_ONE and message.cluster not in ("", self._core.settings.run):
            self._decline_for_another_cluster(peer, message)
            return
        if kind in MEANT_FOR_ONE and not message.cluster and peer not in self._greeted:
            words = "no hello came before it: this client may speak another version of the protocol"
            self._decline(peer, message, RefusalReason.VERSION, words, "send ClientHello first, and await Welcome")
            return
        HANDLERS[kind](self, peer, message, now)

    # --- sentences ------------------------------------------------------------------------------------

    def _take_sentence(self, peer: bytes, message: m.CommandText, now: float) -> None:
        name = name_of(peer)
        key = request_key(name, message.request)
        if known := self._reused_request(key, message):
            words = f"the request {message.request} was another sentence before, {known}; nothing is done"
            self._decline(peer, message, RefusalReason.STATE, words, "give each sentence a request of its own")
            return
        if self._shutdown.begun and key not in self._core.state.requests:
            self._decline(peer, message, RefusalReason.STATE, "the cluster is being stopped", "rtc up")
            return
        if message.halt_if_lost:
            self._health.client_seen_s[name] = now
        if len(message.text) > MAX_TEXT:
            message = msgspec.structs.replace(message, text=message.text[:MAX_TEXT])
        self._core.enqueue(CommandReceived(at_s=now, client=name, sentence=message))

    def _reused_request(self, key: str, message: m.CommandText) -> str:
        """The command already accepted under this (client, request) if its text differs: a restarted client reused a
        request id. Otherwise empty."""
        state = self._core.state
        command = state.requests.get(key)
        if command is None:  # the usual case
            return ""
        if (live := state.commands.get(command)) is not None:
            text = live.text
        elif (ended := state.ended.get(command)) is not None:
            text = read_ended(ended.message).text
        else:
            return ""
        return command if text != message.text[:MAX_TEXT] else ""

    def _mark_alive(self, peer: bytes, message: m.Heartbeat, now: float) -> None:
        if message.name in self._health.client_seen_s:
            self._health.client_seen_s[message.name] = now

    # --- queries --------------------------------------------------------------------------------------

    def _greet(self, peer: bytes, message: m.ClientHello, now: float) -> None:
        self._greeted[peer] = None
        self._greeted.move_to_end(peer)
        if len(self._greeted) > GREETED:
            self._greeted.popitem(last=False)
        self._egress.clients.set_arrays(peer, ARRAYS in message.abilities)
        self._welcome(peer)

    def _send_status(self, peer: bytes, message: m.StatusQuery, now: float) -> None:
        found = status(self._core, self._core.clock())
        self._egress.answer(peer, m.StatusReply(request=message.request, status=found))

    def _send_trace(self, peer: bytes, message: m.TraceQuery, now: float) -> None:
        reply = trace(self._core.state, self._core.journal.record, message)
        if isinstance(reply, m.TraceReply):
            reply = m.TraceReply(request=reply.request, record=self._core.reports.add_to(reply.record))
        self._egress.answer(peer, reply)

    def _send_program(self, peer: bytes, message: m.ProgramQuery, now: float) -> None:
        digest = self._core.state.programs.get(message.kind or CELL, "")
        body = self._core.store.body(digest) or b""
        taken = self._core.state.program_history.get(message.kind or CELL, ())
        history = [
            m.ProgramEntry(digest=one.digest, file=one.file, age_s=now - one.at_s, changes=one.changes)
            for one in reversed(taken)
        ]
        self._egress.answer(
            peer, m.ProgramReply(request=message.request, kind=message.kind, digest=digest, body=body, history=history)
        )

    def _load_program(self, peer: bytes, message: m.ProgramText, now: float) -> None:
        if message.to and program_rollout.taken(self._core.state, message.kind, message.to) is None:
            words = f"{message.to} is not a program that the {message.kind.value}s have used"
            self._decline(peer, message, RefusalReason.PROGRAM, words, "one of those that rtc programs lists")
            return
        if (too_many := self._core.loads.add(peer, message)) is not None:
            self._egress.decline(peer, message.request, too_many)

    def _set_breakpoints(self, peer: bytes, message: m.SetBreakpoints, now: float) -> None:
        known = (self._core.state.programs.get(name, "") for name in ("parser", "elaborator", CELL))
        bodies = ProgramBodies(*(self._core.store.body(digest) or b"" for digest in known))
        new = [one for one in message.breakpoints if one not in self._core.state.breakpoints]
        if (refused := refusal_of(new, bodies)) is not None:
            self._egress.decline(peer, message.request, refused)
            return
        self._core.enqueue(BreakpointsChanged(at_s=now, breakpoints=message.breakpoints))
        self._egress.answer(peer, m.Debugged(request=message.request, breakpoints=message.breakpoints))

    def _step(self, peer: bytes, message: m.StepCommand, now: float) -> None:
        live = self._core.state.commands.get(message.command)
        if live is None or live.phase is not m.Phase.PAUSED:
            query = m.TraceQuery(request=message.request, command=message.command)
            found = trace(self._core.state, self._core.journal.record, query)
            if isinstance(found, m.Declined):  # there is no such command
                self._egress.answer(peer, found)
                return
            words = f"{message.command} {f'is {live.shown_phase.value}' if live else 'has ended'}"
            clears = "rtc break GRASP:5 pauses each GRASP before its fifth step"
            self._decline(peer, message, RefusalReason.STATE, f"{words}, not paused between two steps", clears)
            return
        self._core.enqueue(StepRequested(at_s=now, command=message.command))
        self._egress.answer(peer, m.Debugged(request=message.request, breakpoints=self._core.state.breakpoints))

    def _end_cluster(self, peer: bytes, message: m.Shutdown, now: float) -> None:
        self._core.me.log.info("a client orders the end of the cluster")
        self._egress.send_supervisor(m.Shutdown(request=message.request))

    # --- refusals -------------------------------------------------------------------------------------

    def _exceeds_rate(self, peer: bytes, message: Any, now: float) -> bool:
        if self._queries.take(now, peer, LOAD_QUERIES if isinstance(message, m.ProgramText) else 1):
            return False
        self._core.dropped["questions"] += 1
        words = f"a client may ask {QUERIES_PER_S} times a second; a program counts as {LOAD_QUERIES}"
        self._decline(peer, message, RefusalReason.OVERLOAD, words, "ask again a second later")
        return True

    def _decline_for_another_cluster(self, peer: bytes, message: m.CommandText | m.ProgramText) -> None:
        """A message for an earlier cluster must not move anything now. The welcome comes first: it shows the client
        that the answers it waits for will not come."""
        run = self._core.settings.run
        self._core.dropped["for_another_cluster"] += 1
        self._welcome(peer)
        words = f"meant for the cluster {message.cluster}, which is gone; this is {run or 'another'}"
        clears = "connect again, and give it again if it is meant for this one"
        self._decline(peer, message, RefusalReason.STATE, words, clears)

    def _welcome(self, peer: bytes) -> None:
        self._egress.answer(
            peer, m.Welcome(cluster=self._core.settings.run, pid=os.getpid(), protocol=VERSION, abilities=[ARRAYS])
        )

    def _decline(self, peer: bytes, message: Any, reason: RefusalReason, words: str, clears: str) -> None:
        refusal = Refusal(reason=reason, message=words, clears=by_person(clears))
        text = message.text if isinstance(message, m.CommandText) else ""
        self._egress.decline(peer, message.request, refusal, text)


HANDLERS: dict[type, Callable[[ClientMessages, bytes, Any, float], None]] = {
    m.CommandText: ClientMessages._take_sentence,
    m.Heartbeat: ClientMessages._mark_alive,
    m.ClientHello: ClientMessages._greet,
    m.StatusQuery: ClientMessages._send_status,
    m.TraceQuery: ClientMessages._send_trace,
    m.ProgramQuery: ClientMessages._send_program,
    m.ProgramText: ClientMessages._load_program,
    m.SetBreakpoints: ClientMessages._set_breakpoints,
    m.StepCommand: ClientMessages._step,
    m.Shutdown: ClientMessages._end_cluster,
}
