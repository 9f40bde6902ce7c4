"""The gateway: the only process that other machines can reach, started by `rtc up --listen`.

It binds one tcp port per endpoint, with CURVE. A ZAP handler in its own loop accepts known keys by role. It forwards
what `rtc.protocol.roles` allows to the cluster's ipc sockets, on one DEALER per remote peer. Broker, world database
and MCM see
remote peers like local ones and do not know tcp. Handshakes, floods, unreadable bytes and oversized frames end here. If
the gateway dies, its peers reconnect; local processes are not affected.

Rule 1: the connection's key identifies a peer ("User-Id" of each frame, checked for each message), never the message.
Rule 2: a peer's internal name contains its key's name, so a peer cannot take another's place, answers or commands.
Rule 3: clocks of other machines are not comparable: their times are translated, or replaced by local times.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import zmq
from zmq.utils import z85

from rtc.language.parse import default_grammar, parse
from rtc.language.record import ParsedCommand
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, Refusal, RefusalReason, RtcError, WireError
from rtc.protocol.roles import TCP_ENDPOINTS, Role, admits, may_send, refuse_planner
from rtc.runtime import handover, process
from rtc.runtime.halt_admission import read_order
from rtc.runtime.keys import KeyRing, KnownKey, endpoint_address, secure_server
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import AT_ONCE, MORE, Every, Process, inbox, now_s, send
from rtc.runtime.settings import BOUNDS, Settings

PUBLISHED = ("events", "telemetry")
HALTS = ("halt", "estop")
NAMED = ("front", "workers", "subsystems")  # endpoints whose peers introduce themselves with a hello message
PER_TURN = 16  # messages read per socket and loop iteration, so that the next halt is read soon
HANDSHAKES_PER_TURN = 10
PEERS_OF_KEY = 32  # maximum per endpoint; the one silent for longest is disconnected
UNSENT = 1_000  # maximum queued messages of one peer to the cluster
IDLE_S = 600.0  # a peer silent for so long is removed; it must send its hello again
HALT_AGAIN_S, HALT_KEPT_S = 0.02, 1.0  # retry period and time limit of a halt while its receiver restarts
HALTS_KEPT = 2_000  # maximum number of halts whose callers are stored
NOBODY = (b"", "")
COMMANDS_KEPT = 10_000  # latest commands of one planner that it may control
LOOK_S, LOOKS = 0.2, 10  # period of key reloads, and extra reloads per period for unknown keys
TELL_S, TIDY_S, PROBE_S = 0.5, 1.0, 0.2  # periods: counters to the broker; removal of silent peers; worker probes
OWN_SUBSYSTEM = "MCM"


class Link:
    """Connection of one remote peer into the cluster."""

    def __init__(self, door: str, name: str, key: KnownKey, session: bytes, socket: zmq.Socket[bytes]) -> None:
        self.door, self.name, self.key, self.socket = door, name, key, socket
        self.session = session  # identity of its tcp connection
        self.last_seen_s = now_s()
        self.behind_s = float("inf")  # upper bound of local clock minus peer clock: the smallest difference seen


class Waiting(NamedTuple):
    """A halt that its receiver has not accepted yet."""

    key: KnownKey
    door: str
    session: bytes
    order: m.HaltOrder
    until_s: float


class Gateway:
    def __init__(self, me: Process, settings: Settings, ring: KeyRing) -> None:
        self.me, self.settings, self._ring = me, settings, ring
        self._pair = ring.cluster()
        self._known = {key.public: key for key in ring.known()}
        self._links: dict[tuple[str, bytes], Link] = {}  # by endpoint and session
        self._named: dict[tuple[str, str], Link] = {}  # by endpoint and internal name, for NAMED
        self._by_socket: dict[Any, Link] = {}
        self._halt_lines: dict[tuple[str, str], zmq.Socket[bytes]] = {}  # by endpoint and key: connected in advance
        self._halt_lines_of: dict[Any, str] = {}  # socket -> endpoint
        self._halts_called = 0
        # (endpoint, number of a halt, or its name for answers without number) -> (session, the caller's number)
        self._callers: OrderedDict[tuple[str, str], tuple[bytes, str]] = OrderedDict()
        self._waiting: deque[Waiting] = deque(maxlen=HALTS_KEPT)
        self._commands: dict[str, OrderedDict[str, None]] = {}  # public key of a planner -> its own C-n
        self.counts: Counter[str] = Counter()
        self._told: dict[str, int] = {}
        self._look, self._looks_left = Every(LOOK_S), LOOKS
        self._tell, self._tidy, self._probe = Every(TELL_S), Every(TIDY_S), Every(PROBE_S)
        self._broker = me.socket(zmq.DEALER, settings.endpoint("supervisor"), identity="gate", poll=False)
        self._zap = me.socket(zmq.REP, "inproc://zeromq.zap.01", bind=True)
        self._outside: dict[str, zmq.Socket[bytes]] = {}
        self._inside: dict[str, zmq.Socket[bytes]] = {}  # for published messages
        for door in TCP_ENDPOINTS:
            self._open(door)

    # --- endpoints ----------------------------------------------------------------------------------------

    def _open(self, door: str) -> None:
        """Bind one endpoint. Raises ClusterError if the port is not available."""
        address = endpoint_address(self.settings.listen, door)
        kind = zmq.XPUB if door in PUBLISHED else zmq.ROUTER

        def secure(socket: zmq.Socket[Any]) -> None:
            secure_server(socket, self._pair, door, address)
            if kind == zmq.ROUTER:
                socket.setsockopt(
                    zmq.ROUTER_HANDOVER, 0
                )  # an identity is not a proof: a peer cannot take over a connection
                socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # so that a send to a lost peer fails

        try:
            self._outside[door] = self.me.socket(kind, address, bind=True, bounds=BOUNDS[door], secure=secure)
        except zmq.ZMQError as error:
            why = zmq.strerror(error.errno or 0)
            raise ClusterError(
                f"cannot listen at {address} (for {door}): {why}; --listen wants an address of this machine, "
                f"with {len(TCP_ENDPOINTS)} free ports from the one that is named"
            ) from None
        if door in PUBLISHED:
            self._inside[door] = self.me.socket(zmq.XSUB, self.settings.endpoint(door))

    def _open_anew(self, doors: Sequence[str]) -> None:
        """Cut all connections to these endpoints. Legitimate peers reconnect by themselves."""
        for link in [link for link in self._links.values() if link.door in doors]:
            self._forget(link)
        for door in doors:
            for socket in filter(None, (self._outside.pop(door), self._inside.pop(door, None))):
                self.me.poller.unregister(socket)
                socket.close(linger=0)
        end_s = now_s() + process.OPEN_LIMIT_S
        for door in doors:
            while door not in self._outside:
                try:
                    self._open(door)
                except ClusterError:  # a background thread releases the port
                    if now_s() > end_s:
                        raise
                    time.sleep(0.0005)

    # --- the loop -------------------------------------------------------------------------------------

    def run(self) -> None:
        guard = MemoryGuard()
        while not self.me.stopping:
            self.turn()
            if guard.alarm(now_s()):
                self.me.log.warning("more than %.0f MB: cutting all connections", guard.limit_mb)
                self._open_anew(TCP_ENDPOINTS)

    def turn(self) -> None:
        """One loop iteration: halts first, then handshakes, then the rest."""
        readable = self.me.wait(HALT_AGAIN_S if self._waiting else min(LOOK_S, PROBE_S))
        now = now_s()
        ready = set(readable)
        for door in HALTS:
            if self._outside[door] in ready:
                self._receive(door, now)
        for socket in readable:
            if socket in self._halt_lines_of:
                self._answer_halts(self._halt_lines_of[socket], socket)
        self._offer_halts(now)
        if self._zap in ready:
            self._admit()
        for door in TCP_ENDPOINTS:
            if door in PUBLISHED:
                self._publish(door, ready)
            elif door not in HALTS and self._outside[door] in ready:
                self._receive(door, now)
        for socket in readable:
            if (link := self._by_socket.get(socket)) is not None:
                self._answer(link)
        self._look_after(now)

    def _look_after(self, now: float) -> None:
        if self._look.due(now):
            self._looks_left = LOOKS
            self._look_at_keys()
        if self._tell.due(now) and self.counts != self._told:
            self._told = dict(self.counts)
            send(self._broker, m.Dropped(counts={f"gate_{what}": n for what, n in self.counts.items()}))
        if self._probe.due(now):
            for link in [link for link in self._links.values() if link.door == "workers"]:
                if not self._send_out("workers", link.session, NO_NEWS):
                    self._lose(link)
        if self._tidy.due(now):
            for link in [link for link in self._links.values() if now - link.last_seen_s > IDLE_S]:
                self._forget(link)

    def _look_at_keys(self) -> None:
        """Reload the keys. A removed key loses all its connections."""
        known = {key.public: key for key in self._ring.known()}
        if known == self._known:
            return
        gone = {public: key for public, key in self._known.items() if known.get(public) != key}
        self._known = known
        for link in [link for link in self._links.values() if link.key.public in gone]:
            self._forget(link)
        for (door, public), socket in [item for item in self._halt_lines.items() if item[0][1] in gone]:
            del self._halt_lines[door, public], self._halt_lines_of[socket]
            self._shut(socket)
        for public in gone:
            self._commands.pop(public, None)
        if gone:
            # A single connection cannot be cut. Halt endpoints stay open for the other peers: messages with a revoked
            # key are refused there, because the key of each message is checked.
            doors = [d for d in TCP_ENDPOINTS if d not in HALTS and any(admits(d, key.role) for key in gone.values())]
            names = ", ".join(key.name for key in gone.values())
            self.me.log.info("removed keys: %s; all connections are renewed at %s", names, ", ".join(doors))
            self._open_anew(doors)

    # --- admission ---------------------------------------------------------------------------------

    def _admit(self) -> None:
        """Answer ZAP requests (rfc.zeromq.org/spec/27), one per handshake."""
        for parts in inbox(self._zap, HANDSHAKES_PER_TURN):
            version, number, door, where, _, mechanism, *credentials = parts
            public = z85.encode(credentials[0]).decode() if mechanism == b"CURVE" and credentials else ""
            key = self._known.get(public)
            if key is None and self._looks_left > 0:  # the key may be new; a refusal is final
                self._looks_left -= 1
                self._look_at_keys()
                key = self._known.get(public)
            name, text = door.decode(), b"no key that is known here"
            if key is not None and admits(name, key.role):
                if name in HALTS:
                    self._halt_line(name, key)
                else:
                    self.me.log.info(
                        "%s (%s) comes from %.60r to %s", key.name, key.role, where.decode("latin-1"), name
                    )
                answer = [b"200", b"", public.encode(), b""]
            else:
                self._count("strangers", f"{key.name if key else 'a stranger'} from {where!r:.60} at {name}")
                answer = [b"400", text, b"", b""]
            self._zap.send_multipart([version, number, *answer])

    def _receive(self, door: str, now: float) -> None:
        for session, user, parts in _each_apart(_from_outside(self._outside[door])):
            key = self._known.get(user)
            if key is None or not admits(door, key.role):
                self._count("strangers", f"a key that is not known any more, at {door}")
                self._refuse(door, session, None, "this key is not known here (any more)")
                continue
            try:
                message = READ[door](parts)
            except WireError as error:
                self._count("unreadable", f"{key.name} at {door}: {error}")
                words = f"no message of this protocol: {error}"
                self._refuse(door, session, None, words, RefusalReason.SENTENCE, wire.name_in(parts))
                continue
            if not may_send(door, key.role, message):
                self._count("refused", f"{key.name}: {type(message).__name__} at {door}")
                words = f"not allowed: {key.name} is {_a(key.role)}, who may not say {type(message).__name__}"
                self._refuse(door, session, message, words)
                continue
            self._take(door, key, session, message, parts, now)

    def _take(self, door: str, key: KnownKey, session: bytes, message: Any, parts: Sequence[bytes], now: float) -> None:
        if isinstance(message, m.HaltOrder) and door in HALTS:
            self._halt(door, key, session, message, now)
            return
        if isinstance(message, m.Heartbeat) and door == "front":  # on a line of its own, for a client named in it
            name = f"{key.name}/{message.name}"
            if (link := self._named.get((door, name))) is not None:
                self._forward(link, wire.frames(m.Heartbeat(name=name)), message)
            return
        link = self._link(door, key, session, message)
        if link is None:
            return
        link.last_seen_s = now
        if isinstance(message, m.ClientHello):
            link.behind_s = now - message.at_s if message.at_s > 0 else link.behind_s
            parts = wire.frames(m.ClientHello(client=link.name, arrays=message.arrays))
        elif isinstance(message, m.CommandText):
            if isinstance(refusal := self._no_sentence(key, message), Refusal):
                self._count("refused", f"{key.name}: {message.text!r:.80}")
                self._send_out(door, session, wire.frames(m.Declined(request=message.request, refusal=refusal)))
                return
            parts = wire.frames(_translated(link, message, now))
        self._forward(link, parts, message)

    def _link(self, door: str, key: KnownKey, session: bytes, message: Any) -> Link | None:
        """The peer's link. It is created by its hello, or by its first message at an endpoint without names."""
        link = self._links.get((door, session))
        if link is not None and link.key.public != key.public:  # another peer that chose the same identity
            self._forget(link)
            link = None
        if link is not None and not isinstance(message, HELLOS):
            return link
        if door not in NAMED:
            return self._connect(door, "", key, session)
        if not isinstance(message, HELLOS):
            self._ask_for_hello(door, session)
            return None
        name = _name_inside(key, message)
        if wrong := self._no_name(door, key, name, message):
            self._count("refused", f"{key.name} at {door}: {wrong}")
            if door == "workers":
                self._send_out(door, session, wire.frames(m.Shutdown()))
            return None
        if link is not None and link.name != name:
            self._forget(link)
        before = self._named.get((door, name))
        if before is None:
            return self._connect(door, name, key, session)
        if before.session != session:  # the same peer, on a new connection
            self._links.pop((door, before.session), None)
            before.session = session
            self._links[door, session] = before
        return before

    def _no_name(self, door: str, key: KnownKey, name: str, hello: Any) -> str:
        """The reason why a peer must not have this name; empty if it may."""
        if door == "subsystems" and (name != key.name or name == OWN_SUBSYSTEM):
            return f"a subsystem is called as its key is, {key.name}, and not {OWN_SUBSYSTEM}"
        if door == "workers":
            if name != f"{hello.kind}@{hello.node}" or list(m.WorkerKind)[hello.node & 3] is not hello.kind:
                return f"{name!r:.60} is no name of a {hello.kind} at node {hello.node}"
            if hello.node < (first := first_far_node(self.settings)):
                return f"node {hello.node} is one of the cluster's own machine; others begin at {first}"
        other = self._named.get((door, name))
        if other is not None and other.key.public != key.public:
            return f"{name!r:.60} is there already, with the key {other.key.name}"
        return ""

    def _ask_for_hello(self, door: str, session: bytes) -> None:
        """Request a hello message, as the broker does."""
        asks = {"workers": m.JobBatch(jobs=[]), "subsystems": m.ReportAck(primitive="")}
        if (question := asks.get(door)) is not None:
            self._send_out(door, session, wire.frames(question))
        else:
            self._count("nameless", "something before a ClientHello")
            self._refuse(door, session, None, "over tcp send ClientHello first", RefusalReason.STATE)

    def _connect(self, door: str, name: str, key: KnownKey, session: bytes) -> Link | None:
        mine = [link for link in self._links.values() if link.door == door and link.key.public == key.public]
        if len(mine) >= PEERS_OF_KEY:
            self._forget(min(mine, key=lambda link: link.last_seen_s))
        try:
            socket = self.me.socket(
                zmq.DEALER, self.settings.endpoint(door), identity=name, queue_length=max(UNSENT, BOUNDS[door].unsent)
            )
        except zmq.ZMQError as error:  # no file descriptors left
            self._count("unsent", f"no connection for {key.name}: {error}")
            return None
        link = Link(door, name, key, session, socket)
        self._links[door, session] = self._by_socket[socket] = link
        if name:
            self._named[door, name] = link
        return link

    def _forget(self, link: Link, linger_ms: int = 0) -> None:
        if self._links.pop((link.door, link.session), None) is not None:
            self._named.pop((link.door, link.name), None)
            del self._by_socket[link.socket]
            self._shut(link.socket, linger_ms)

    def _shut(self, socket: zmq.Socket[bytes], linger_ms: int = 0) -> None:
        self.me.poller.unregister(socket)
        socket.close(linger=linger_ms)

    def _no_sentence(self, key: KnownKey, message: m.CommandText) -> Refusal | None:
        """The refusal of a sentence that a planner may not give. It is parsed with the default grammar: a sentence that
        this grammar does not accept could have any meaning in a grammar loaded later."""
        if key.role is not Role.PLANNER:
            return None
        parsed = parse(default_grammar(), message.text)
        if not isinstance(parsed, ParsedCommand):
            return parsed
        words = refuse_planner(parsed, lambda command: command in self._commands.get(key.public, ()))
        return Refusal(reason=RefusalReason.NOT_ALLOWED, message=f"not allowed: {words}") if words else None

    def _forward(self, link: Link, parts: Sequence[bytes], message: Any) -> None:
        if not _push(link.socket, parts):
            self._count("unsent", f"of {link.key.name} at {link.door}")
            words = "the cluster accepts no more messages from this peer now"
            self._refuse(link.door, link.session, message, words, RefusalReason.OVERLOAD)

    # --- halts ----------------------------------------------------------------------------------------

    def _halt_line(self, door: str, key: KnownKey) -> zmq.Socket[bytes]:
        """The halt socket of a key, connected in advance: a halt must never wait in a queue for a restarted broker."""
        line = self._halt_lines.get((door, key.public))
        if line is None:

            def at_once(socket: zmq.Socket[Any]) -> None:
                socket.setsockopt(zmq.IMMEDIATE, 1)

            line = self.me.socket(zmq.DEALER, self.settings.endpoint(door), secure=at_once)
            self._halt_lines[door, key.public] = line
            self._halt_lines_of[line] = door
        return line

    def _halt(self, door: str, key: KnownKey, session: bytes, order: m.HaltOrder, now: float) -> None:
        self._halts_called += 1  # each order gets a unique number, because two callers may use one name
        call = f"gate {self._halts_called}"
        self._callers[door, call] = self._callers[door, order.halt] = session, order.call
        while len(self._callers) > HALTS_KEPT:
            self._callers.popitem(last=False)
        order = msgspec.structs.replace(order, called_at_s=now, call=call)
        if not send(self._halt_line(door, key), order):
            self._waiting.append(Waiting(key, door, session, order, now + HALT_KEPT_S))

    def _offer_halts(self, now: float) -> None:
        for _ in range(len(self._waiting)):
            halt = self._waiting.popleft()
            if halt.key.public not in self._known or send(self._halt_line(halt.door, halt.key), halt.order):
                continue
            if now < halt.until_s:
                self._waiting.append(halt)
            else:
                who = "the broker" if halt.door == "halt" else "the MCM"
                self._count("unsent", f"a halt of {halt.key.name}, to {who}")
                self._refuse(halt.door, halt.session, halt.order, f"{who} is unavailable", RefusalReason.TIMEOUT)

    def _answer_halts(self, door: str, line: zmq.Socket[bytes]) -> None:
        for parts in inbox(line, PER_TURN):
            with contextlib.suppress(WireError):
                answer: m.FromHalt = READ_HALT_ANSWER(parts)
                if isinstance(answer, m.Declined):
                    session, _ = self._callers.get((door, answer.request), NOBODY)
                else:
                    session, call = self._callers.get((door, answer.call or answer.halt), NOBODY)
                    parts = wire.frames(msgspec.structs.replace(answer, call=call))
                if session:
                    self._send_out(door, session, parts)

    # --- egress --------------------------------------------------------------------------------

    def _answer(self, link: Link) -> None:
        for parts in inbox(link.socket, PER_TURN):
            if link.key.role is Role.PLANNER and link.door == "front":
                self._remember_commands(link.key, parts)
            if not self._send_out(link.door, link.session, parts):
                self._lose(link)
                return

    def _lose(self, link: Link) -> None:
        """Remove a lost peer. For a worker, report the loss at once, so that its jobs do not wait for a time limit."""
        if link.door == "workers":
            self.me.log.info("%s is gone", link.name)
            _push(link.socket, wire.frames(m.WorkerGone(name=link.name)))
        self._forget(link, linger_ms=process.LINGER_MS)

    def _remember_commands(self, key: KnownKey, parts: Sequence[bytes]) -> None:
        with contextlib.suppress(WireError):
            for answer in READ_ANSWERS(parts):
                if not isinstance(answer, m.Accepted):
                    continue
                own = self._commands.setdefault(key.public, OrderedDict())
                own[answer.command] = None
                if len(own) > COMMANDS_KEPT:
                    own.popitem(last=False)

    def _publish(self, door: str, ready: set[Any]) -> None:
        """Forward published messages outwards and subscriptions inwards."""
        outside, inside = self._outside[door], self._inside[door]
        if outside in ready:
            for frame, *more in inbox(outside, PER_TURN):
                if not more and frame[:1] in (b"\0", b"\1") and wire.PROTOCOL.startswith(frame[1:]):
                    _push(inside, [frame])
                else:
                    self._count("unreadable", f"at {door}: no subscription")
        if inside in ready:
            for parts in inbox(inside, PER_TURN):
                _push(outside, parts)

    def _send_out(self, door: str, session: bytes, parts: Sequence[bytes]) -> bool:
        """False: the peer is lost. A peer that does not read loses messages, as inside the cluster."""
        try:
            _send_all(self._outside[door], [session, *parts])
        except zmq.ZMQError as error:
            if error.errno == zmq.EHOSTUNREACH:
                return False
            if error.errno != zmq.EAGAIN:
                raise
            self._count("unsent", f"a peer at {door} does not read")
        return True

    def _refuse(
        self,
        door: str,
        session: bytes,
        message: Any,
        words: str,
        reason: RefusalReason = RefusalReason.NOT_ALLOWED,
        request: str = "",
    ) -> None:
        """Send a refusal, if the protocol has a message for it at this endpoint."""
        refusal = Refusal(reason=reason, message=words)
        request = request or getattr(message, "request", "") or getattr(message, "halt", "")
        if door in ("front", *HALTS):
            self._send_out(door, session, wire.frames(m.Declined(request=request, refusal=refusal)))
        elif door == "world":
            self._send_out(door, session, wire.frames(m.WorldRefused(request=request, refusal=refusal)))

    def _count(self, what: str, words: str) -> None:
        """Count for `rtc status`; log the 1st, 2nd, 4th, 8th ... occurrence."""
        self.counts[what] += 1
        if (n := self.counts[what]) & (n - 1) == 0:
            self.me.log.warning("%s (%d so far): %s", what, n, words)


def first_far_node(settings: Settings) -> int:
    """The lowest node address that local workers never use."""
    return max(1 << settings.dim, len(m.WorkerKind) * max(settings.most_workers, settings.least))


def _name_inside(key: KnownKey, hello: Any) -> str:
    """The internal name: a worker or subsystem keeps its name, a client's name is prefixed with its key's."""
    return f"{key.name}/{hello.client}" if isinstance(hello, m.ClientHello) else str(hello.name)


def _translated(link: Link, message: m.CommandText, now: float) -> m.CommandText:
    """The command with local times, and with the source that its role implies."""
    sent_at_s = 0.0
    if 0.0 < message.sent_at_s < float("inf"):
        link.behind_s = min(link.behind_s, now - message.sent_at_s)
        sent_at_s = max(0.0, message.sent_at_s + link.behind_s)
    source = "aip" if link.key.role is Role.PLANNER else message.source
    return msgspec.structs.replace(message, sent_at_s=sent_at_s, source=source)


def _from_outside(socket: zmq.Socket[bytes]) -> Iterator[tuple[bytes, str, list[bytes]]]:
    """Yield (session, user-id, frames) of queued messages. `_admit` set the user-id at the handshake."""
    for _ in range(PER_TURN):
        try:
            part = socket.recv(AT_ONCE, copy=False)
        except zmq.Again:
            return
        parts = [part.bytes]
        while part.more:
            part = socket.recv(AT_ONCE, copy=False)
            parts.append(part.bytes)
        try:
            user = str(part.get("User-Id"))
        except zmq.ZMQError:
            user = ""
        yield parts[0], user, parts[1:]


def _each_apart(
    messages: Iterator[tuple[bytes, str, list[bytes]]],
) -> Iterator[tuple[bytes, str, Sequence[bytes]]]:
    """Split arrays of messages: each message is allowed or refused separately."""
    for session, user, parts in messages:
        for one in wire.apart(parts):
            yield session, user, one


def _push(socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> bool:
    """False: the queue is full."""
    try:
        _send_all(socket, parts)
    except zmq.Again:
        return False
    return True


def _send_all(socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> None:
    *heads, last = parts
    for part in heads:
        socket.send(part, MORE)
    socket.send(last, AT_ONCE)


def _a(role: Role) -> str:
    return f"an {role}" if role[0] in "aeiou" else f"a {role}"


NO_NEWS = wire.frames(m.Drop(jobs=[]))  # a probe without effect: the send fails if the peer is lost
HELLOS = (m.ClientHello, m.WorkerHello, m.SubsystemHello)
READ_ANSWERS = wire.reader_of_many(m.BrokerToClient)
READ_HALT_ANSWER = wire.reader(m.FromHalt)
#: endpoint -> reader of its messages. It reads all internal messages, so that a refusal can name the type
READ: dict[str, Callable[[Sequence[bytes]], Any]] = {
    "front": wire.reader(m.ClientToBroker),
    "halt": read_order,
    "estop": read_order,
    "world": wire.reader(m.ToWorld),
    "workers": wire.reader(m.WorkerToBroker),
    "subsystems": wire.reader(m.SubsystemToBroker),
}


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
    settings = handover.begin("gate", run_dir, fd).settings
    with process.start("gate", run_dir) as me:
        process.nice(-5)  # not real-time: foreign messages must not delay arms and broker
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # foreign connections must not exhaust the descriptors
        default_grammar()  # built now, because it would delay a halt later
        try:
            gate = Gateway(me, settings, KeyRing(run_dir))
        except RtcError as error:
            raise SystemExit(str(error)) from None
        process.freeze_heap()
        me.ready()
        gate.run()


if __name__ == "__main__":
    main()
