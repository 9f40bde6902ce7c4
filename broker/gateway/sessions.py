"""Sessions: one connection into the cluster per remote peer, and the rules for the peers' internal names.

Rule 1: a peer is identified by its connection's key ("User-Id" of each frame), never by what its message says.
Rule 2: a peer's internal name contains its key's name, so a peer cannot take another's place, answers or commands.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import msgspec
import zmq

from broker.gateway.endpoints import Peer, ServerSockets, close, push
from broker.gateway.peers import OpenConnection
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.spelling import unknown
from rtc.runtime import process
from rtc.runtime.keys import PEERS_OF_KEY, KnownKey
from rtc.runtime.process import Process, now_s
from rtc.runtime.settings import BOUNDS, Settings

NAMED = ("front", "workers", "subsystems")  # endpoints whose peers introduce themselves with a hello message
HELLOS = (m.ClientHello, m.WorkerHello, m.SubsystemHello)
ALIVE_S = 1.5  # three heartbeats: a worker that has sent something within this time is alive
UNSENT = 1_000  # maximum queued messages of one peer to the cluster
IDLE_S = 600.0  # a peer silent for so long is removed; it must send its hello again
# Without effect at the worker. The send fails if the peer is lost; and data under way is what the kernel needs to
# detect a cut link (LINK_LIMIT_S).
PROBE = wire.frames(m.CancelJobs(jobs=[]))


class PeerConnection:
    """Connection of one remote peer into the cluster."""

    def __init__(self, endpoint: str, name: str, key: KnownKey, peer: Peer, socket: zmq.Socket[bytes]) -> None:
        self.endpoint, self.name, self.key, self.socket = endpoint, name, key, socket
        self.session, self.host = peer.session, peer.host  # of its tcp connection
        self.last_seen_s = now_s()
        self.behind_s = float("inf")  # upper bound of local clock minus peer clock: the smallest difference seen
        self.instance = ""  # of a worker whose address was assigned here
        self.pid = 0  # of a worker
        self.round_trip_s: float | None = None  # of a worker's latest heartbeat to the broker and back
        self.round_trip_at_s = 0.0


class Sessions:
    def __init__(self, me: Process, settings: Settings, endpoints: ServerSockets) -> None:
        self._me, self._settings, self._endpoints = me, settings, endpoints
        self._links: dict[tuple[str, bytes], PeerConnection] = {}  # by endpoint and session
        self._named: dict[tuple[str, str], PeerConnection] = {}  # by endpoint and internal name, for NAMED
        self._by_socket: dict[Any, PeerConnection] = {}

    def by_name(self, endpoint: str, name: str) -> PeerConnection | None:
        return self._named.get((endpoint, name))

    def readable(self, sockets: Iterable[Any]) -> list[PeerConnection]:
        """The links that have an answer of the cluster."""
        return [link for socket in sockets if (link := self._by_socket.get(socket)) is not None]

    def find_or_connect(self, endpoint: str, key: KnownKey, peer: Peer, message: Any) -> PeerConnection | None:
        """The peer's link. It is created by its hello, or by its first message at an endpoint without names. None:
        the message is refused, or must be repeated after a hello."""
        session = peer.session
        link = self._links.get((endpoint, session))
        if link is not None and link.key.public != key.public:  # another peer that chose the same identity
            self.remove(link)
            link = None
        if link is not None and not isinstance(message, HELLOS):
            return link
        if endpoint not in NAMED:
            return self._connect(endpoint, "", key, peer)
        if not isinstance(message, HELLOS):
            self._count_stale(key, peer, message)
            self._request_hello(endpoint, session)
            return None
        return self._admit(endpoint, key, peer, message, link)

    def _admit(
        self, endpoint: str, key: KnownKey, peer: Peer, message: Any, link: PeerConnection | None
    ) -> PeerConnection | None:
        """The link of a peer that has sent a hello; None: it is refused, or waits. `link`: of its connection so far."""
        session = peer.session
        if isinstance(message, m.WorkerHello) and message.instance:
            message = self._with_address(key, message)
        name = _internal_name(key, message)
        if wrong := self._name_fault(endpoint, key, name, message) or self._overload(endpoint, key, name):
            self._endpoints.count_refusal("refused", key.name, peer.host, wrong)
            if endpoint == "workers":
                self._endpoints.send(endpoint, session, wire.frames(m.Shutdown(why=wrong)))
            return None
        if link is not None and link.name != name:
            self.remove(link)
        before = self._named.get((endpoint, name))
        if before is not None and self._may_be_another(before, peer, message):
            return None
        if before is None:
            before = self._connect(endpoint, name, key, peer)
        elif before.session != session:  # the same peer, on a new connection
            self._links.pop((endpoint, before.session), None)
            before.session, before.host = session, peer.host
            self._links[endpoint, session] = before
        if before is not None and isinstance(message, m.WorkerHello):
            before.instance, before.pid = message.instance, message.pid
            self._endpoints.records.join(key.name, peer.host, name, now_s())
        return before

    def _may_be_another(self, before: PeerConnection, peer: Peer, hello: Any) -> bool:
        """True if another process has chosen this address too and may be alive: its connection is not lost. A newcomer
        repeats its hello until the address is free, or until the other one has sent something: then it is refused. A
        worker whose address was assigned gives it up and gets another."""
        if not isinstance(hello, m.WorkerHello) or hello.instance or before.instance:
            return False
        if (before.pid, before.host) == (hello.pid, peer.host):
            return False
        if now_s() - before.last_seen_s < ALIVE_S:
            words = f"{before.name} is there already, from {before.host}; start this one without --node"
            self._endpoints.count_refusal("refused", before.key.name, peer.host, words)
            self._endpoints.send("workers", peer.session, wire.frames(m.Shutdown(why=words)))
        return True

    def _name_fault(self, endpoint: str, key: KnownKey, name: str, hello: Any) -> str:
        """The reason why a peer must not have this name; empty if it may."""
        if endpoint == "subsystems":
            started = [one.name for one in self._settings.subsystems if one.module]
            others = [one.name for one in self._settings.subsystems if not one.module]
            if name != key.name or name in started:
                return f"a subsystem is called as its key is, {key.name}, and not {' or '.join(started)}"
            if name not in others:
                return unknown("subsystem of this cell for other machines", name, others)
        if endpoint == "workers":
            if hello.node is None:
                return f"a {hello.kind} without an address needs an instance, and a free address"
            if (kind := list(m.WorkerKind)[hello.node & 3]) is not hello.kind:
                return f"the two low bits of node {hello.node} are those of a {kind}; leave out --node"
            if name != f"{hello.kind}@{hello.node}":
                return f"{name!r:.60} is not the name of a {hello.kind} at node {hello.node}"
            if hello.node < (first := self._settings.first_remote_node):
                return f"node {hello.node} is one of the cluster's own machine; others begin at {first}"
        other = self._named.get((endpoint, name))
        if other is not None and other.key.public != key.public:
            return f"{name!r:.60} is there already, with the key {other.key.name}"
        return ""

    def _overload(self, endpoint: str, key: KnownKey, name: str) -> str:
        """The reason why this key gets no further worker; empty if it may have one. A silent worker may be busy."""
        if endpoint != "workers" or (endpoint, name) in self._named or len(self._of_key(endpoint, key)) < PEERS_OF_KEY:
            return ""
        return f"the key {key.name} has {PEERS_OF_KEY} workers already; make a further key: rtc keys new"

    def _with_address(self, key: KnownKey, hello: m.WorkerHello) -> m.WorkerHello:
        """The hello with an address: that of this instance, else the one it had before, else the lowest free one."""
        same = (link for link in self._of_key("workers", key) if link.instance == hello.instance)
        if (link := next(same, None)) is not None and link.name.startswith(f"{hello.kind}@"):
            return msgspec.structs.replace(hello, name=link.name, node=node_of(link.name))
        kinds, first = list(m.WorkerKind), self._settings.first_remote_node
        lowest = first + (kinds.index(hello.kind) - first) % len(kinds)
        free = range(lowest, m.NODES, len(kinds))
        for node in free if hello.node not in free else (hello.node, *free):
            if ("workers", name := f"{hello.kind}@{node}") not in self._named:
                return msgspec.structs.replace(hello, name=name, node=node)
        return hello

    def _request_hello(self, endpoint: str, session: bytes) -> None:
        """Request a hello message, as the broker does. A client is refused."""
        if endpoint != "front":
            self._endpoints.send(endpoint, session, wire.frames(m.HelloWanted()))
        else:
            self._endpoints.count("nameless", "a message before a ClientHello")
            words = "over tcp send ClientHello first"
            self._endpoints.refuse(endpoint, session, None, words, RefusalReason.STATE)

    def _count_stale(self, key: KnownKey, peer: Peer, message: Any) -> None:
        """Results of jobs that an earlier connection of the worker had: they were given to other workers."""
        for result in message.results if isinstance(message, m.ResultBatch) else ():
            words = f"result of {result.id:.60}, from an earlier connection of {message.name:.60}"
            self._endpoints.count_refusal("stale", key.name, peer.host, words)

    def _connect(self, endpoint: str, name: str, key: KnownKey, peer: Peer) -> PeerConnection | None:
        of_key = self._of_key(endpoint, key)
        if len(of_key) >= PEERS_OF_KEY:
            self.remove(min(of_key, key=lambda link: link.last_seen_s))
        try:
            socket = self._me.socket(
                zmq.DEALER,
                self._settings.endpoint(endpoint),
                identity=name,
                queue_length=max(UNSENT, BOUNDS[endpoint].unsent),
            )
        except zmq.ZMQError as error:  # no file descriptors left
            self._endpoints.count("unsent", f"no connection for {key.name}: {error}")
            return None
        link = PeerConnection(endpoint, name, key, peer, socket)
        self._links[endpoint, peer.session] = self._by_socket[socket] = link
        if name:
            self._named[endpoint, name] = link
        return link

    def _of_key(self, endpoint: str, key: KnownKey) -> list[PeerConnection]:
        return [link for link in self._links.values() if link.endpoint == endpoint and link.key.public == key.public]

    def connections(self) -> Iterator[OpenConnection]:
        """The connected peers that have introduced themselves."""
        for link in self._named.values():
            worker = None
            if link.endpoint == "workers":
                worker = m.RemoteWorker(
                    name=link.name,
                    last_message_at_s=link.last_seen_s,
                    round_trip_s=link.round_trip_s,
                    round_trip_at_s=link.round_trip_at_s,
                )
            yield OpenConnection(link.key.name, link.host, worker)

    def remove(self, link: PeerConnection, linger_ms: int = 0, in_order: bool = False) -> None:
        if link.endpoint == "workers" and not in_order:
            self._endpoints.records.lose(link.key.name, link.host, link.name, now_s())
        if self._links.pop((link.endpoint, link.session), None) is not None:
            self._named.pop((link.endpoint, link.name), None)
            del self._by_socket[link.socket]
            close(self._me, link.socket, linger_ms)

    def remove_lost(self, link: PeerConnection, in_order: bool = False) -> None:
        """Remove a lost peer. For a worker, report the loss at once, so that its jobs do not wait for a time limit.

        `in_order`: the worker itself reported its end."""
        if link.endpoint == "workers":
            self._me.log.info("%s is gone", link.name)
            push(link.socket, wire.frames(m.WorkerGone(name=link.name, in_order=in_order)))
        self.remove(link, process.LINGER_MS, in_order)

    def remove_of_keys(self, public: Collection[str]) -> None:
        for link in [link for link in self._links.values() if link.key.public in public]:
            if link.endpoint == "workers":
                self.remove_lost(link)
            else:
                self.remove(link)

    def remove_at(self, endpoints: Collection[str]) -> None:
        self._remove_where(lambda link: link.endpoint in endpoints)

    def remove_idle(self, now: float) -> None:
        self._remove_where(lambda link: now - link.last_seen_s > IDLE_S)

    def probe_workers(self) -> None:
        """Find lost workers by a message without effect."""
        for link in [link for link in self._links.values() if link.endpoint == "workers"]:
            if not self._endpoints.send("workers", link.session, PROBE):
                self.remove_lost(link)

    def _remove_where(self, wanted: Callable[[PeerConnection], bool]) -> None:
        for link in [link for link in self._links.values() if wanted(link)]:
            self.remove(link)


def node_of(worker: str) -> int:
    """The address in the name of a worker."""
    return int(worker.rpartition("@")[2])


def _internal_name(key: KnownKey, hello: Any) -> str:
    """A worker or subsystem keeps its name; a client's name is prefixed with its key's."""
    return f"{key.name}/{hello.client}" if isinstance(hello, m.ClientHello) else str(hello.name)
