"""The gate: the one process that other machines can reach. `python -m broker.gate --run-dir D`, when `rtc up --listen`
was said.

It binds one tcp port for each door, with CURVE; a ZAP handler in its own loop says who is known, and for what role.
What `rtc.roles` lets through goes on by the cluster's own ipc sockets, on a DEALER for each remote peer, so broker,
world database and MCM see clients and workers like any others and know nothing of tcp. Handshakes, floods, unreadable
bytes and oversized frames end here; a gate that dies costs its peers a reconnection and the others nothing.

Rule 1: who somebody is, the connection's key says ("User-Id" of each frame, looked up for each message), never the
message. Rule 2: a peer's name inside is made of its key's name, so nobody can take another's place, answers or
commands. Rule 3: clocks of other machines mean nothing here: times are translated, or replaced by ours.
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

from rtc import handed, process, wire
from rtc import messages as m
from rtc.halt_admission import read_order
from rtc.keys import KeyRing, KnownKey, endpoint_address, secure_server
from rtc.language.parse import default_grammar, parse
from rtc.language.record import ParsedCommand
from rtc.memory import MemoryGuard
from rtc.outcomes import ClusterError, Refusal, RefusalReason, RtcError, WireError
from rtc.process import AT_ONCE, MORE, Every, Process, inbox, now_s, send
from rtc.roles import TCP_ENDPOINTS, Role, admits, may_send, refuse_planner
from rtc.settings import BOUNDS, Settings

PUBLISHED = ("events", "telemetry")
HALTS = ("halt", "estop")
NAMED = ("front", "workers", "subsystems")  # doors where the first word is a hello that names the peer
PER_TURN = 16  # messages of one door, and of one peer's answers, so that the next halt is soon seen
HANDSHAKES_PER_TURN = 10
PEERS_OF_KEY = 32  # at one door; the one that has been silent longest gives way
UNSENT = 1_000  # messages of one peer that wait for the cluster
IDLE_S = 600.0  # who has said nothing for so long is forgotten; it says hello again
HALT_AGAIN_S, HALT_KEPT_S = 0.02, 1.0  # a halt whose door is shut is offered again for so long: a broker restarts
HALTS_KEPT = 2_000  # names and numbers of halts whose answers are delivered
NOBODY = (b"", "")
COMMANDS_KEPT = 10_000  # of one planner, that it may control
LOOK_S, LOOKS = 0.2, 10  # at the keys; and so often between, when somebody comes who is not known
TELL_S, TIDY_S, PROBE_S = 0.5, 1.0, 0.2  # what was counted, to the broker; who is silent; whether workers are there
OWN_SUBSYSTEM = "MCM"


class Link:
    """One remote peer's way into the cluster."""

    def __init__(self, door: str, name: str, key: KnownKey, session: bytes, socket: zmq.Socket[bytes]) -> None:
        self.door, self.name, self.key, self.socket = door, name, key, socket
        self.session = session  # by which its tcp connection is known
        self.heard_s = now_s()
        self.behind_s = float("inf")  # our clock minus the peer's, at most: as small as was ever seen


class Waiting(NamedTuple):
    """A halt that its door did not take yet."""

    key: KnownKey
    door: str
    session: bytes
    order: m.HaltOrder
    until_s: float


class Gate:
    def __init__(self, me: Process, settings: Settings, ring: KeyRing) -> None:
        self.me, self.settings, self._ring = me, settings, ring
        self._pair = ring.cluster()
        self._known = {key.public: key for key in ring.known()}
        self._links: dict[tuple[str, bytes], Link] = {}  # by door and session
        self._named: dict[tuple[str, str], Link] = {}  # by door and name inside, at the doors in NAMED
        self._by_socket: dict[Any, Link] = {}
        self._halt_lines: dict[tuple[str, str], zmq.Socket[bytes]] = {}  # by door and key: connected in advance
        self._halt_lines_of: dict[Any, str] = {}  # the door of each
        self._halts_called = 0
        # Door and number of a halt, or its name for answers that bear no number -> session, and the caller's number.
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
        self._inside: dict[str, zmq.Socket[bytes]] = {}  # of what is published
        for door in TCP_ENDPOINTS:
            self._open(door)

    # --- doors ----------------------------------------------------------------------------------------

    def _open(self, door: str) -> None:
        """Raises ClusterError when the port cannot be had."""
        address = endpoint_address(self.settings.listen, door)
        kind = zmq.XPUB if door in PUBLISHED else zmq.ROUTER

        def secure(socket: zmq.Socket[Any]) -> None:
            secure_server(socket, self._pair, door, address)
            if kind == zmq.ROUTER:
                socket.setsockopt(zmq.ROUTER_HANDOVER, 0)  # a name is no proof: nobody takes another's connection over
                socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # so that we learn who is gone

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
        """Cut all connections to these doors. Those who belong here come back by themselves."""
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
                except ClusterError:  # the port is let go of by a thread of its own
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
        """Halts first, then who wants to come in, then the rest."""
        readable = self.me.wait(HALT_AGAIN_S if self._waiting else min(LOOK_S, PROBE_S))
        now = now_s()
        ready = set(readable)
        for door in HALTS:
            if self._outside[door] in ready:
                self._hear(door, now)
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
                self._hear(door, now)
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
            for link in [link for link in self._links.values() if now - link.heard_s > IDLE_S]:
                self._forget(link)

    def _look_at_keys(self) -> None:
        """Who is known now. A key that is not known any more loses all it has here."""
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
            # One connection cannot be cut alone. Where halts come in nobody is cut off for another's sake: what comes
            # with a revoked key is refused there all the same, as each message is looked at.
            doors = [d for d in TCP_ENDPOINTS if d not in HALTS and any(admits(d, key.role) for key in gone.values())]
            names = ", ".join(key.name for key in gone.values())
            self.me.log.info("not known any more: %s; connections are made anew at %s", names, ", ".join(doors))
            self._open_anew(doors)

    # --- who comes in ---------------------------------------------------------------------------------

    def _admit(self) -> None:
        """ZAP (rfc.zeromq.org/spec/27): one question for each handshake."""
        for parts in inbox(self._zap, HANDSHAKES_PER_TURN):
            version, number, door, where, _, mechanism, *credentials = parts
            public = z85.encode(credentials[0]).decode() if mechanism == b"CURVE" and credentials else ""
            key = self._known.get(public)
            if key is None and self._looks_left > 0:  # it may have been made a moment ago; a refusal is final
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

    def _hear(self, door: str, now: float) -> None:
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
        link.heard_s = now
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
        """The peer's way in; made when it says hello, or, where nobody has a name, when it speaks first."""
        link = self._links.get((door, session))
        if link is not None and link.key.public != key.public:  # somebody else, who has chosen the same identity
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
        """Why a peer may not be called so; empty when it may."""
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
        """As the broker does itself."""
        asks = {"workers": m.JobBatch(jobs=[]), "subsystems": m.ReportAck(primitive="")}
        if (question := asks.get(door)) is not None:
            self._send_out(door, session, wire.frames(question))
        else:
            self._count("nameless", "something before a ClientHello")
            self._refuse(door, session, None, "over tcp say ClientHello first", RefusalReason.STATE)

    def _connect(self, door: str, name: str, key: KnownKey, session: bytes) -> Link | None:
        mine = [link for link in self._links.values() if link.door == door and link.key.public == key.public]
        if len(mine) >= PEERS_OF_KEY:
            self._forget(min(mine, key=lambda link: link.heard_s))
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
        """Why a planner may not say this. It is read by the language as it comes with the project: what cannot be read
        here might mean anything to a grammar that was loaded since."""
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
            words = "the cluster takes no more from you just now"
            self._refuse(link.door, link.session, message, words, RefusalReason.OVERLOAD)

    # --- halts ----------------------------------------------------------------------------------------

    def _halt_line(self, door: str, key: KnownKey) -> zmq.Socket[bytes]:
        """A halt is never kept in a queue for a broker that comes back later: these are connected in advance."""
        line = self._halt_lines.get((door, key.public))
        if line is None:

            def at_once(socket: zmq.Socket[Any]) -> None:
                socket.setsockopt(zmq.IMMEDIATE, 1)

            line = self.me.socket(zmq.DEALER, self.settings.endpoint(door), secure=at_once)
            self._halt_lines[door, key.public] = line
            self._halt_lines_of[line] = door
        return line

    def _halt(self, door: str, key: KnownKey, session: bytes, order: m.HaltOrder, now: float) -> None:
        self._halts_called += 1  # each order has a number of its own: two callers may use one name
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
                self._refuse(halt.door, halt.session, halt.order, f"{who} is away", RefusalReason.TIMEOUT)

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

    # --- what goes out --------------------------------------------------------------------------------

    def _answer(self, link: Link) -> None:
        for parts in inbox(link.socket, PER_TURN):
            if link.key.role is Role.PLANNER and link.door == "front":
                self._remember_commands(link.key, parts)
            if not self._send_out(link.door, link.session, parts):
                self._lose(link)
                return

    def _lose(self, link: Link) -> None:
        """Nobody is at the other end. A worker's jobs need not wait until somebody misses them."""
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
        """What is published goes out; all that comes in are subscriptions."""
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
        """False: nobody is there any more. Who does not read loses what it is told, as inside."""
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
        """Tell it, where the protocol has a word for it."""
        refusal = Refusal(reason=reason, message=words)
        request = request or getattr(message, "request", "") or getattr(message, "halt", "")
        if door in ("front", *HALTS):
            self._send_out(door, session, wire.frames(m.Declined(request=request, refusal=refusal)))
        elif door == "world":
            self._send_out(door, session, wire.frames(m.WorldRefused(request=request, refusal=refusal)))

    def _count(self, what: str, words: str) -> None:
        """For `rtc status`; the log hears of the 1st, 2nd, 4th, 8th ..."""
        self.counts[what] += 1
        if (n := self.counts[what]) & (n - 1) == 0:
            self.me.log.warning("%s (%d so far): %s", what, n, words)


def first_far_node(settings: Settings) -> int:
    """The lowest address that this machine's own workers never take."""
    return max(1 << settings.dim, len(m.WorkerKind) * max(settings.most_workers, settings.least))


def _name_inside(key: KnownKey, hello: Any) -> str:
    """A worker or subsystem keeps its name; a client's begins with its key's, which says whose commands they are."""
    return f"{key.name}/{hello.client}" if isinstance(hello, m.ClientHello) else str(hello.name)


def _translated(link: Link, message: m.CommandText, now: float) -> m.CommandText:
    """With our time, and a source that the role tells."""
    sent_at_s = 0.0
    if 0.0 < message.sent_at_s < float("inf"):
        link.behind_s = min(link.behind_s, now - message.sent_at_s)
        sent_at_s = max(0.0, message.sent_at_s + link.behind_s)
    source = "aip" if link.key.role is Role.PLANNER else message.source
    return msgspec.structs.replace(message, sent_at_s=sent_at_s, source=source)


def _from_outside(socket: zmq.Socket[bytes]) -> Iterator[tuple[bytes, str, list[bytes]]]:
    """(session, user-id, frames) of what lies ready. The user-id is what `_admit` said at the handshake."""
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
    """An array of messages as single ones: each is allowed or refused for itself."""
    for session, user, parts in messages:
        for one in wire.apart(parts):
            yield session, user, one


def _push(socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> bool:
    """False: no room."""
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


NO_NEWS = wire.frames(m.Drop(jobs=[]))  # harmless; whoever is gone cannot be told it
HELLOS = (m.ClientHello, m.WorkerHello, m.SubsystemHello)
READ_ANSWERS = wire.reader_of_many(m.BrokerToClient)
READ_HALT_ANSWER = wire.reader(m.FromHalt)
#: door -> how its messages are read: all that the inner door takes, so that what is not allowed can be named
READ: dict[str, Callable[[Sequence[bytes]], Any]] = {
    "front": wire.reader(m.ClientToBroker),
    "halt": read_order,
    "estop": read_order,
    "world": wire.reader(m.ToWorld),
    "workers": wire.reader(m.WorkerToBroker),
    "subsystems": wire.reader(m.SubsystemToBroker),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m broker.gate", description="The gate of a cluster for tcp.")
    parser.add_argument("--run-dir", required=True, type=Path)
    handed.add_option(parser)
    given = parser.parse_args()
    live(given.run_dir, given.handed)


def live(run_dir: Path, fd: int = -1) -> None:
    """Be the gate until told to end."""
    process.show_name("gate")
    settings = handed.begin("gate", run_dir, fd).settings
    with process.start("gate", run_dir) as me:
        process.nice(-5)  # no real time: what strangers send shall not take the processor from arms and broker
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # strangers' connections shall not use them up
        default_grammar()  # made now: later it would hold up a halt
        try:
            gate = Gate(me, settings, KeyRing(run_dir))
        except RtcError as error:
            raise SystemExit(str(error)) from None
        process.freeze_heap()
        me.ready()
        gate.run()


if __name__ == "__main__":
    main()
