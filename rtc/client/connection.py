"""Client's connection to the broker: a DEALER that repeats unanswered requests and survives the loss of a broker.

Over TCP the hello identifies the client to the gateway, so it is sent first on every new connection and after a long
pause. The module knows requests and their answers, but not their meaning.

Rule 1: a request is forgotten only after its last answer (for a sentence: `CommandEnded`), so that all open requests
can be sent again to a new broker. Rule 2: repeating is harmless, because the broker identifies a request by (client,
request). Rule 3: requests are repeated only to a broker of the same cluster, according to its Welcome. Requests that
act carry the cluster's name, because ZeroMQ may deliver a message for one broker to the next. Rule 4: sending never
blocks.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable

import msgspec
import zmq

from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, Refusal, RefusalReason, RequestDeclined, WireError
from rtc.protocol.versions import ARRAYS, VERSION, misfit
from rtc.protocol.wire import MAX_BYTES, frames, reader_of_many, together
from rtc.runtime.keys import Endpoints
from rtc.runtime.link import Link
from rtc.runtime.settings import BOUNDS

HELLO_S, REMOTE_HELLO_S = 0.8, 3.0  # time limit of the first Welcome, local and over tcp
SLOW_HELLO_S = 45.0  # the same over a slow link, whose handshake takes four round trips
RESTART_S = 10.0  # the same while the supervisor lives and restarts the broker
LOOK_S = 0.2  # period of checking that the supervisor lives
FAR_IDLE_S = 60.0  # after this pause the hello is repeated, because a gateway forgets idle clients
LAST_WORDS_MS = 200  # time limit for sending the rest at close
SILENCE_S = 2.0  # without a message for this long, the broker is probed
LAST_ANSWERS = (m.Declined, m.CommandEnded, m.StatusReply, m.TraceReply, m.ProgramLoaded, m.ProgramReply, m.Debugged)
ACTS = (m.CommandText, m.ProgramText)  # only for the cluster that they were submitted to

_read = reader_of_many(m.BrokerToClient)


class BrokerConnection:
    """One connection; not thread-safe. `cluster`: the run that is meant; "" = the first that sends a Welcome."""

    def __init__(
        self, context: zmq.Context[zmq.Socket[bytes]], endpoints: Endpoints, name: str, cluster: str = ""
    ) -> None:
        self.name = name
        self._address, self._far = endpoints.endpoint("front"), endpoints.far
        self._sent_at_s = 0.0
        self._hellos: deque[float] = deque()  # when they were sent, of those without a Welcome
        self.round_trip_s = 0.0  # of the latest hello and its Welcome over tcp: limits of waits are longer by it
        self._cluster = cluster
        self.welcome: m.Welcome | None = None
        self.replaced = False  # another cluster has taken the place of ours: nothing is sent to it
        self.refused: Refusal | None = None  # of our hello, or of the broker's: another version of the protocol
        self.unanswered = 0  # number of probes without an answer
        self._open: dict[str, m.ClientToBroker] = {}  # request -> message, until its last answer
        self._resend = False  # send all open requests again after the next Welcome
        self._unsent: list[msgspec.Raw] = []  # requests that the next `recv` sends together
        self._received: deque[m.BrokerToClient] = deque()  # the rest of a received array
        self._received_at_s = time.monotonic()
        self._socket = context.socket(zmq.DEALER)
        if not self._far:
            self._socket.setsockopt(zmq.IDENTITY, name.encode())
        endpoints.secure(self._socket)
        self._socket.setsockopt(zmq.LINGER, LAST_WORDS_MS)  # closing must not wait for a broker that is gone
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
        self._socket.setsockopt(zmq.SNDHWM, 10_000)
        self._socket.setsockopt(zmq.RCVHWM, 100_000)
        self._link = Link(self._socket)
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._link.monitor, zmq.POLLIN)
        self._waker: int | None = None
        self._socket.connect(self._address)
        self._send_hello()

    def connect(self, run_dir: str, restarting: Callable[[], bool], report: Callable[[], None]) -> m.Welcome:
        """Wait for the Welcome. While `restarting()`, call `report` once and wait longer, at most RESTART_S.

        Raises NoCluster if the broker does not answer in time, RequestDeclined if it speaks another version.
        """
        began_s = time.monotonic()
        limit_s = began_s + (REMOTE_HELLO_S if self._far else HELLO_S)
        reported = False
        while self.welcome is None:
            left_s = limit_s - time.monotonic()
            if left_s <= 0 and self._far and self._link.is_slow:
                left_s = began_s + SLOW_HELLO_S - time.monotonic()
            if self._link.key_refused or (self._far and left_s <= 0):
                raise NoCluster(self._link.diagnose())
            if left_s <= 0 and time.monotonic() - began_s < RESTART_S and restarting():
                if not reported:
                    report()
                reported, left_s = True, LOOK_S
            if left_s <= 0:
                raise NoCluster(
                    f"no broker answers in {run_dir}; look at `rtc status`, or start a cluster with: rtc up -d"
                )
            self.recv(left_s)
            if self.refused is not None:
                raise RequestDeclined(self.refused)
        return self.welcome

    def send(self, request: str, message: m.ClientToBroker) -> None:
        """Send a request and keep it open until its last answer. Raises RequestDeclined for one that is too long."""
        if self._far and time.monotonic() - self._sent_at_s > FAR_IDLE_S:
            self._send_hello()
        parts = self._parts(message)
        if isinstance(message, ACTS) and self.welcome is None and not self._cluster:
            self._resend = True  # sent after the Welcome: it names the cluster
        elif self.welcome is not None and ARRAYS in self.welcome.abilities:
            self._unsent.append(msgspec.Raw(parts[-1]))
        else:
            self._send_frames(parts)
        self._open[request] = message

    def wake_by(self, descriptor: int) -> None:
        """`recv` also returns when this eventfd has been written, which it reads."""
        self._waker = descriptor
        self._poller.register(descriptor, zmq.POLLIN)

    def forget(self, request: str) -> None:
        """Stop waiting for the answer to this request."""
        self._open.pop(request, None)

    def recv(self, timeout_s: float) -> m.BrokerToClient | None:
        """The next message; None if there was none in time, or only a change of the connection."""
        if self.replaced:
            return None
        self._send_unsent()
        if self._received:
            return self._handle(self._received.popleft())
        ready = dict(self._poller.poll(max(0, math.ceil(min(timeout_s, SILENCE_S) * 1000))))
        if self._link.monitor in ready and self._link.newly_connected():
            waiting, self._hellos = len(self._hellos), deque()
            if self._link.handshakes > 1:
                self._probe()  # a new broker, or the old one again: messages in transit may be lost
            elif waiting:
                self._hellos.append(time.monotonic())  # it waited for the connection
        if self._waker is not None and self._waker in ready:
            os.eventfd_read(self._waker)
        if self._socket not in ready:
            if self._open and time.monotonic() - self._received_at_s > SILENCE_S + self.round_trip_s:
                self._received_at_s = time.monotonic()
                self.unanswered += 1
                self._probe()
            return None
        self._received_at_s = time.monotonic()
        self.unanswered = 0
        try:
            self._received.extend(_read(self._socket.recv_multipart()))
        except WireError:
            return None
        return self._handle(self._received.popleft()) if self._received else None

    def _handle(self, message: m.BrokerToClient) -> m.BrokerToClient:
        if isinstance(message, m.Welcome):
            self._take_welcome(message)
        if isinstance(message, m.Accepted):
            self._keep_number(message)
        if isinstance(message, m.Declined) and not message.request and message.refusal.reason is RefusalReason.VERSION:
            self.refused = message.refusal
        if isinstance(message, LAST_ANSWERS):
            self._open.pop(message.request, None)
        return message

    def _keep_number(self, accepted: m.Accepted) -> None:
        """A repeated sentence carries its number, so that a broker that has lost it does not begin it again."""
        sentence = self._open.get(accepted.request)
        if isinstance(sentence, m.CommandText) and not sentence.known_as:
            self._open[accepted.request] = msgspec.structs.replace(sentence, known_as=accepted.command)

    @property
    def lost(self) -> bool:
        """Over tcp: there was a connection, and there is none now."""
        return self._far and self._link.lost

    @property
    def key_refused(self) -> str:
        """A message if the cluster has refused our key (over tcp only), otherwise empty."""
        return self._link.diagnose() if self._link.key_refused else ""

    def close(self) -> None:
        self._send_unsent()
        self._link.close()
        self._socket.close()

    def _parts(self, message: m.ClientToBroker) -> list[bytes]:
        """The frames of a request. Raises RequestDeclined if it is longer than a broker accepts."""
        if isinstance(message, ACTS):
            message = msgspec.structs.replace(message, cluster=self._cluster)
        parts = frames(message)
        if len(parts[-1]) > BOUNDS["front"].frame:  # a longer frame would disconnect us at each repeat
            words = f"too long: {len(parts[-1]):,} bytes, a request may have {BOUNDS['front'].frame:,}"
            raise RequestDeclined(Refusal(reason=RefusalReason.SENTENCE, message=words))
        return parts

    def _send_frames(self, parts: list[bytes]) -> bool:
        """Send; False if the queue is full: then all open requests are sent again after the next Welcome."""
        self._sent_at_s = time.monotonic()
        try:
            self._socket.send_multipart(parts, zmq.NOBLOCK)
        except zmq.Again:
            self._resend = True
            return False
        return True

    def _send_unsent(self) -> None:
        unsent, self._unsent = self._unsent, []
        for parts in together(unsent):
            self._send_frames(parts)

    def _send_hello(self) -> None:
        self._hellos.append(time.monotonic())
        self._send_frames(
            frames(m.ClientHello(client=self.name, at_s=time.monotonic(), protocol=VERSION, abilities=[ARRAYS]))
        )

    def _probe(self) -> None:
        """Send a hello; its Welcome makes us repeat all open requests. Without a connection this waits for the next."""
        self._resend = True
        if self._link.is_up:
            self._send_hello()

    def _take_welcome(self, welcome: m.Welcome) -> None:
        if words := misfit("this cluster", welcome.protocol, "this program"):
            clears = "use the version of rtc that the cluster was started with"
            self.refused = Refusal(reason=RefusalReason.VERSION, message=words, clears=clears)
            return
        if self._hellos and self._far:
            self.round_trip_s = time.monotonic() - self._hellos.popleft()
        another = self._cluster not in ("", welcome.cluster)
        if another and (
            self.welcome is not None or self._open
        ):  # without open requests, the cluster may have been started during our first hello
            self.replaced = True
            self._open.clear()
            return
        self._cluster, self.welcome = welcome.cluster, welcome
        if self._resend:
            self._resend = False
            for message in self._open.values():
                if not self._send_frames(self._parts(message)):
                    break
