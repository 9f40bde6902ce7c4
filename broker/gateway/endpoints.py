"""The gateway's endpoints: one tcp socket per endpoint of the cluster, what is sent on it, and the counters.

Must not know keys' rights or commands.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import zmq

from broker.gateway.peers import PeerRecords
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, Refusal, RefusalReason
from rtc.protocol.roles import TCP_ENDPOINTS
from rtc.runtime import process
from rtc.runtime.keys import KeyPair, endpoint_address, secure_server
from rtc.runtime.process import AT_ONCE, MORE, Disconnections, Process, inbox, now_s
from rtc.runtime.settings import BOUNDS, Settings

PUBLISHED = ("events", "telemetry")  # endpoints that publish; the others answer
HALTS = ("halt", "estop")
MAX_MESSAGES = 16  # messages read per socket and loop iteration, so that the next halt is read soon
REBIND_S = 0.0005  # period of attempts to bind a port again


class Peer(NamedTuple):
    """The sender of a message. Admission has set the public key at the handshake."""

    session: bytes  # identity of its connection
    public: str
    host: str  # network address


class ServerSockets:
    """`outside`: the tcp sockets by endpoint. `inside`: subscriptions in the cluster, of the published ones.
    `lost_workers`: connections of workers that were closed.

    Raises ClusterError if a port is not available.
    """

    def __init__(self, me: Process, settings: Settings, pair: KeyPair) -> None:
        self._me, self._settings, self._pair = me, settings, pair
        self.counts: Counter[str] = Counter()  # events for `rtc status`
        self.records = PeerRecords()
        self.outside: dict[str, zmq.Socket[bytes]] = {}
        self.inside: dict[str, zmq.Socket[bytes]] = {}
        for endpoint in TCP_ENDPOINTS:
            self._open(endpoint)

    def _open(self, endpoint: str) -> None:
        """Bind one endpoint. Raises ClusterError if the port is not available."""
        address = endpoint_address(self._settings.listen, endpoint)
        kind = zmq.XPUB if endpoint in PUBLISHED else zmq.ROUTER

        def secure(socket: zmq.Socket[Any]) -> None:
            secure_server(socket, self._pair, endpoint, address)
            if kind == zmq.ROUTER:
                # An identity is not a proof: a peer cannot take over a connection.
                socket.setsockopt(zmq.ROUTER_HANDOVER, 0)
                socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # so that a send to a lost peer fails

        try:
            self.outside[endpoint] = self._me.socket(kind, address, bind=True, bounds=BOUNDS[endpoint], secure=secure)
        except zmq.ZMQError as error:
            why = zmq.strerror(error.errno or 0)
            raise ClusterError(
                f"cannot listen at {address} (for {endpoint}): {why}; --listen wants an address of this machine, "
                f"with {len(TCP_ENDPOINTS)} free ports from the one that is named"
            ) from None
        if endpoint == "workers":
            self.lost_workers = Disconnections(self._me, self.outside[endpoint])
        if endpoint in PUBLISHED:
            self.inside[endpoint] = self._me.socket(zmq.XSUB, self._settings.endpoint(endpoint))

    def reopen(self, endpoints: Sequence[str]) -> None:
        """Cut all connections to these endpoints. Legitimate peers reconnect by themselves."""
        if "workers" in endpoints:
            self.lost_workers.close()
        for endpoint in endpoints:
            for socket in filter(None, (self.outside.pop(endpoint), self.inside.pop(endpoint, None))):
                close(self._me, socket)
        end_s = now_s() + process.OPEN_LIMIT_S
        for endpoint in endpoints:
            while endpoint not in self.outside:
                try:
                    self._open(endpoint)
                except ClusterError:  # a background thread releases the port
                    if now_s() > end_s:
                        raise
                    time.sleep(REBIND_S)

    def forward_published(self, endpoint: str, ready: set[Any]) -> None:
        """Forward published messages outwards and subscriptions inwards."""
        outside, inside = self.outside[endpoint], self.inside[endpoint]
        if outside in ready:
            for frame, *more in inbox(outside, MAX_MESSAGES):
                if not more and frame[:1] in (b"\0", b"\1") and wire.PROTOCOL.startswith(frame[1:]):
                    push(inside, [frame])
                else:
                    self.count("unreadable", f"at {endpoint}: not a subscription")
        if inside in ready:
            for parts in inbox(inside, MAX_MESSAGES):
                push(outside, parts)

    def messages(self, endpoint: str) -> Iterator[tuple[Peer, Sequence[bytes]]]:
        """Yield the sender and the frames of queued messages, those of an array separately: each of them is allowed or
        refused alone."""
        for peer, parts in _received(self.outside[endpoint]):
            for one in wire.split(parts):
                yield peer, one

    def send(self, endpoint: str, session: bytes, parts: Sequence[bytes]) -> bool:
        """Send to a remote peer. False: the peer is lost. A peer that does not read loses messages."""
        try:
            _send_all(self.outside[endpoint], [session, *parts])
        except zmq.ZMQError as error:
            if error.errno == zmq.EHOSTUNREACH:
                return False
            if error.errno != zmq.EAGAIN:
                raise
            self.count("unsent", f"a peer at {endpoint} does not read")
        return True

    def refuse(
        self,
        endpoint: str,
        session: bytes,
        message: Any,
        words: str,
        reason: RefusalReason = RefusalReason.NOT_ALLOWED,
        request: str = "",
    ) -> None:
        """Send a refusal, if the protocol has a message for it at this endpoint."""
        refusal = Refusal(reason=reason, message=words)
        request = request or getattr(message, "request", "") or getattr(message, "halt", "")
        if endpoint in ("front", *HALTS):
            self.send(endpoint, session, wire.frames(m.Declined(request=request, refusal=refusal)))
        elif endpoint == "world":
            self.send(endpoint, session, wire.frames(m.WorldRefused(request=request, refusal=refusal)))

    def count(self, what: str, words: str) -> None:
        """Count for `rtc status`; log the 1st, 2nd, 4th, 8th ... occurrence."""
        self.counts[what] += 1
        if (n := self.counts[what]) & (n - 1) == 0:
            self._me.log.warning("%s (%d so far): %s", what, n, words)

    def count_refusal(self, what: str, key: str, host: str, words: str) -> None:
        """Count a refused handshake or message, also for its key and host. `key`: its name; empty = an unknown key."""
        self.count(what, f"{key or 'an unknown key'} from {host or '?'}: {words}")
        self.records.refuse(key, host, words, now_s())


def close(me: Process, socket: zmq.Socket[bytes], linger_ms: int = 0) -> None:
    """Stop polling a socket and close it."""
    me.poller.unregister(socket)
    socket.close(linger=linger_ms)


def push(socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> bool:
    """Send frames without waiting. False: the queue is full."""
    try:
        _send_all(socket, parts)
    except zmq.Again:
        return False
    return True


def _received(socket: zmq.Socket[bytes]) -> Iterator[tuple[Peer, list[bytes]]]:
    """Yield (sender, frames)."""
    for _ in range(MAX_MESSAGES):
        try:
            part = socket.recv(AT_ONCE, copy=False)
        except zmq.Again:
            return
        parts = [part.bytes]
        while part.more:
            part = socket.recv(AT_ONCE, copy=False)
            parts.append(part.bytes)
        yield Peer(parts[0], _property(part, "User-Id"), _property(part, "Peer-Address")), parts[1:]


def _property(part: Any, name: str) -> str:
    """A property of the connection that a frame came from; empty if it has none."""
    try:
        return str(part.get(name))
    except zmq.ZMQError:
        return ""


def _send_all(socket: zmq.Socket[bytes], parts: Sequence[bytes]) -> None:
    *heads, last = parts
    for part in heads:
        socket.send(part, MORE)
    socket.send(last, AT_ONCE)
