"""The gateway: the only process that other machines can reach, started by `rtc up --listen`.

It binds one tcp port per endpoint, with CURVE (`endpoints`), and accepts known keys by role (`admission`). It keeps one
DEALER into the cluster per remote peer (`sessions`). It forwards what `rtc.protocol.roles` allows. Broker, world
database and MCM see remote peers like local ones and do not know tcp. Handshakes, floods, unreadable bytes and
oversized frames end here. If the gateway dies, its peers reconnect; local processes are not affected.

Clocks of other machines are not comparable: their times are translated, or replaced by local times.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import zmq

from broker.gateway.admission import RELOAD_S, Admission
from broker.gateway.endpoints import HALTS, MAX_MESSAGES, PUBLISHED, Peer, ServerSockets, push
from broker.gateway.halt_forwarding import RETRY_S, HaltForwarder
from broker.gateway.sessions import PeerConnection, Sessions, node_of
from rtc.language.parse import default_grammar, parse
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason, RtcError, WireError
from rtc.protocol.roles import TCP_ENDPOINTS, Role, a_role, admits, may_send, refuse_planner
from rtc.protocol.sentence import ParsedCommand
from rtc.protocol.versions import VERSION
from rtc.runtime import handover, process
from rtc.runtime.halt_admission import read_order
from rtc.runtime.keys import KeyRing, KnownKey
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Every, Process, inbox, now_s, send
from rtc.runtime.settings import Settings

COMMANDS_KEPT = 10_000  # latest commands of one planner that it may control
ROWS = 1_000  # maximum number of rows in a report
REPORT_S, TIDY_S, PROBE_S = 0.5, 1.0, 0.2  # periods: counters to the broker; removal of silent peers; worker probes
# After a disconnection the lost worker is searched with probes for a while, because the event names no peer.
SEARCH_S, SEARCH_EVERY_S = 0.1, 0.002

read_answers = wire.reader_of_many(m.BrokerToClient)
#: endpoint -> reader of its messages. It reads all internal messages, so that a refusal can name the type
READ: dict[str, Callable[[Sequence[bytes]], Any]] = {
    "front": wire.reader(m.ClientToBroker),
    "halt": read_order,
    "estop": read_order,
    "world": wire.reader(m.ToWorld),
    "workers": wire.reader(m.WorkerToBroker),
    "subsystems": wire.reader(m.SubsystemToBroker),
    "operate": wire.reader(m.Operate),
}


class Gateway:
    def __init__(self, me: Process, settings: Settings, ring: KeyRing) -> None:
        self._me = me
        # First, so that each handshake at the endpoints finds it.
        handshakes: zmq.Socket[bytes] = me.socket(zmq.REP, "inproc://zeromq.zap.01", bind=True)
        self._endpoints = ServerSockets(me, settings, ring.cluster())
        self._halts = HaltForwarder(me, settings, self._endpoints)
        self._sessions = Sessions(me, settings, self._endpoints)
        self._admission = Admission(me, handshakes, ring, self._endpoints, self._halts, self._cut_removed)
        self._commands: dict[str, OrderedDict[str, None]] = {}  # public key of a planner -> its own C-n
        self._broker = me.socket(zmq.DEALER, settings.endpoint("supervisor"), identity="gate", poll=False)
        send(self._broker, m.ProcessHello(name="gate", protocol=VERSION))
        self._reported: dict[str, int] = {}  # counters as last sent
        self._report, self._tidy, self._probe = Every(REPORT_S), Every(TIDY_S), Every(PROBE_S)
        self._search, self._search_until_s = Every(SEARCH_EVERY_S), 0.0

    # --- the loop -------------------------------------------------------------------------------------

    def run(self, guard: MemoryGuard) -> None:
        while not self._me.stopping:
            self.run_once()
            if guard.alarm(now_s()):
                self._me.log.warning("more than %.0f MB: cutting all connections", guard.limit_mb)
                self._reopen(TCP_ENDPOINTS)

    def run_once(self) -> None:
        """One loop iteration: halts first, then handshakes, then the rest."""
        readable = self._me.wait(self._wait_limit_s())
        now, ready = now_s(), set(readable)
        for endpoint in HALTS:
            if self._endpoints.outside[endpoint] in ready:
                self._receive(endpoint, now)
        self._halts.answer(readable)
        self._halts.retry(self._admission.known, now)
        if self._admission.socket in ready:
            self._admission.answer_handshakes()
        for endpoint in TCP_ENDPOINTS:
            if endpoint in PUBLISHED:
                self._endpoints.forward_published(endpoint, ready)
            elif endpoint not in HALTS and self._endpoints.outside[endpoint] in ready:
                self._receive(endpoint, now)
        for link in self._sessions.readable(readable):
            self._return_answers(link)
        self._check(now)

    def _wait_limit_s(self) -> float:
        if now_s() < self._search_until_s:
            return SEARCH_EVERY_S
        return RETRY_S if self._halts.waiting else min(RELOAD_S, PROBE_S)

    def _check(self, now: float) -> None:
        self._admission.reload_if_due(now)
        counts = self._endpoints.counts
        if self._report.due(now):
            self._report_peers(now)
            if counts != self._reported:
                self._reported = dict(counts)
                send(self._broker, m.UnreadableMessages(counts={f"gate_{what}": n for what, n in counts.items()}))
        if self._endpoints.lost_workers.happened():
            self._search_until_s = now + SEARCH_S
        if (self._search if now < self._search_until_s else self._probe).due(now):
            self._sessions.probe_workers()
        if self._tidy.due(now):
            self._sessions.remove_idle(now)

    def _report_peers(self, now: float) -> None:
        known, revoked = (
            {key.name: key for key in keys.values()} for keys in (self._admission.known, self._admission.revoked)
        )
        rows = self._endpoints.records.rows(known, revoked, self._sessions.connections(), now)
        send(self._broker, m.GatewayReport(peers=rows[:ROWS]))

    def _reopen(self, endpoints: Sequence[str]) -> None:
        """Cut all connections to these endpoints. Legitimate peers reconnect by themselves."""
        self._sessions.remove_at(endpoints)
        self._endpoints.reopen(endpoints)

    def _cut_removed(self, removed: dict[str, KnownKey]) -> None:
        """Cut all connections of removed keys."""
        self._sessions.remove_of_keys(removed)
        self._halts.close(removed)
        for public in removed:
            self._commands.pop(public, None)
        # A single connection cannot be cut. Halt endpoints stay open for the other peers: messages with a revoked key
        # are refused there, because the key of each message is checked.
        roles = {key.role for key in removed.values()}
        endpoints = [e for e in TCP_ENDPOINTS if e not in HALTS and any(admits(e, role) for role in roles)]
        names = ", ".join(key.name for key in removed.values())
        self._me.log.info("removed keys: %s; all connections are renewed at %s", names, ", ".join(endpoints))
        self._reopen(endpoints)

    # --- from outside ---------------------------------------------------------------------------------

    def _receive(self, endpoint: str, now: float) -> None:
        for peer, parts in self._endpoints.messages(endpoint):
            key = self._admission.known.get(peer.public)
            if key is None or not admits(endpoint, key.role):
                self._refuse(endpoint, peer, "strangers", "this key is not known here (any more)")
                continue
            self._endpoints.records.received(key.name, peer.host, now)
            try:
                message = READ[endpoint](parts)
            except WireError as error:
                words = f"not a message of this protocol for {endpoint}: {error}"
                self._refuse(endpoint, peer, "unreadable", words, None, RefusalReason.SENTENCE, wire.name_in(parts))
                continue
            if not may_send(endpoint, key.role, message):
                kind = type(message).__name__
                words = f"not allowed: {key.name} is {a_role(key.role)}, a role that may not send {kind}"
                self._refuse(endpoint, peer, "refused", words, message)
                continue
            self._handle(endpoint, key, peer, message, parts, now)

    def _refuse(
        self,
        endpoint: str,
        peer: Peer,
        what: str,
        words: str,
        message: Any = None,
        reason: RefusalReason = RefusalReason.NOT_ALLOWED,
        request: str = "",
    ) -> None:
        """Count a refused message and send the refusal."""
        self._endpoints.count_refusal(what, self._admission.name_of(peer.public), peer.host, words)
        self._endpoints.refuse(endpoint, peer.session, message, words, reason, request)

    def _handle(
        self, endpoint: str, key: KnownKey, peer: Peer, message: Any, parts: Sequence[bytes], now: float
    ) -> None:
        """Forward a message that the role may send."""
        session = peer.session
        if isinstance(message, m.HaltOrder) and endpoint in HALTS:
            self._halts.forward(endpoint, key, session, message, now)
            return
        if isinstance(message, m.Heartbeat) and endpoint == "front":  # on its own connection; it names its client
            name = f"{key.name}/{message.name}"
            if (link := self._sessions.by_name(endpoint, name)) is not None:
                self._forward(link, wire.frames(m.Heartbeat(name=name)), message)
            return
        link = self._sessions.find_or_connect(endpoint, key, peer, message)
        if link is None:
            return
        link.last_seen_s = now
        if isinstance(message, m.ClientHello):
            link.behind_s = now - message.at_s if message.at_s > 0 else link.behind_s
            parts = wire.frames(msgspec.structs.replace(message, client=link.name, at_s=0.0))
        elif isinstance(message, m.WorkerHello) and message.instance:
            node = node_of(link.name)
            self._endpoints.send(endpoint, session, wire.frames(m.WorkerAddress(name=link.name, node=node)))
            parts = wire.frames(msgspec.structs.replace(message, name=link.name, node=node))
        elif isinstance(message, m.Heartbeat) and message.round_trip_s is not None:
            link.round_trip_s, link.round_trip_at_s = message.round_trip_s, now
        elif isinstance(message, m.WorkerGone):
            self._sessions.remove_lost(link, in_order=True)
            return
        elif isinstance(message, m.CommandText):
            if (refusal := self._refuse_sentence(key, message)) is not None:
                self._endpoints.count_refusal("refused", key.name, peer.host, refusal.message)
                declined = m.Declined(request=message.request, refusal=refusal)
                self._endpoints.send(endpoint, session, wire.frames(declined))
                return
            parts = wire.frames(_translated(link, message, now))
        elif isinstance(message, m.Operate):  # its time is the subsystem's: it needs no translation
            parts = wire.frames(msgspec.structs.replace(message, operator=f"{key.name}/{message.operator}"))
        self._forward(link, parts, message)

    def _forward(self, link: PeerConnection, parts: Sequence[bytes], message: Any) -> None:
        if not push(link.socket, parts):
            self._endpoints.count("unsent", f"of {link.key.name} at {link.endpoint}")
            words = "the cluster accepts no more messages from this peer now"
            self._endpoints.refuse(link.endpoint, link.session, message, words, RefusalReason.OVERLOAD)

    # --- what a planner may command -------------------------------------------------------------------

    def _refuse_sentence(self, key: KnownKey, message: m.CommandText) -> Refusal | None:
        """The refusal of a sentence that a planner may not give. It is parsed with the default grammar: a sentence that
        this grammar does not accept could have any meaning in a grammar loaded later."""
        if key.role is not Role.PLANNER:
            return None
        parsed = parse(default_grammar(), message.text)
        if not isinstance(parsed, ParsedCommand):
            return parsed
        words = refuse_planner(parsed, lambda command: command in self._commands.get(key.public, ()))
        return Refusal(reason=RefusalReason.NOT_ALLOWED, message=f"not allowed: {words}") if words else None

    def _remember_commands(self, key: KnownKey, parts: Sequence[bytes]) -> None:
        with contextlib.suppress(WireError):
            for answer in read_answers(parts):
                if not isinstance(answer, m.Accepted):
                    continue
                own = self._commands.setdefault(key.public, OrderedDict())
                own[answer.command] = None
                if len(own) > COMMANDS_KEPT:
                    own.popitem(last=False)

    # --- from the cluster -----------------------------------------------------------------------------

    def _return_answers(self, link: PeerConnection) -> None:
        for parts in inbox(link.socket, MAX_MESSAGES):
            if link.key.role is Role.PLANNER and link.endpoint == "front":
                self._remember_commands(link.key, parts)
            if not self._endpoints.send(link.endpoint, link.session, parts):
                self._sessions.remove_lost(link)
                return


def _translated(link: PeerConnection, message: m.CommandText, now: float) -> m.CommandText:
    """The command with local times, and with the source that its role implies."""
    sent_at_s = 0.0
    if 0.0 < message.sent_at_s < float("inf"):
        link.behind_s = min(link.behind_s, now - message.sent_at_s)
        sent_at_s = max(0.0, message.sent_at_s + link.behind_s)
    source = "aip" if link.key.role is Role.PLANNER else message.source
    return msgspec.structs.replace(message, sent_at_s=sent_at_s, source=source)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m broker.gateway.gateway", description="The tcp gateway of a cluster."
    )
    parser.add_argument("--run-dir", required=True, type=Path)
    handover.add_option(parser)
    given = parser.parse_args()
    live(given.run_dir, given.handed)


def live(run_dir: Path, fd: int = -1) -> None:
    """Run the gateway until it is ordered to end."""
    process.show_name("gate")
    settings = handover.claim_role("gate", run_dir, fd).settings
    with process.start("gate", run_dir) as me:
        process.nice(-5)  # not real-time: foreign messages must not delay arms and broker
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # foreign connections must not exhaust the descriptors
        default_grammar()  # built now, because it would delay a halt later
        try:
            gateway = Gateway(me, settings, KeyRing(run_dir))
        except RtcError as error:
            raise SystemExit(str(error)) from None
        process.freeze_heap()
        me.ready()
        gateway.run(MemoryGuard())


if __name__ == "__main__":
    main()
