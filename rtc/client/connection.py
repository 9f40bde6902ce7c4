"""A client's connection to the broker: the DEALER on which the frames of a `ClientCore` travel. Sending never blocks.

`step` is the shell for threads; `exchange` is that for an event loop, which watches `descriptors`.
"""

from __future__ import annotations

import math
import time

import zmq

from rtc.client.core import SILENCE_S, ClientCore
from rtc.client.liveness import BrokerLiveness
from rtc.protocol.wire import MAX_BYTES
from rtc.runtime.keys import Endpoints
from rtc.runtime.link import Link
from rtc.runtime.settings import BOUNDS

LAST_WORDS_MS = 200  # time limit for sending the rest at close


class BrokerConnection:
    """One connection; not thread-safe. `cluster`: the run that is meant; "" = the first that sends a Welcome."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        endpoints: Endpoints,
        name: str,
        cluster: str = "",
        liveness: BrokerLiveness | None = None,
    ) -> None:
        address = endpoints.endpoint("front")
        self._socket = context.socket(zmq.DEALER)
        if not endpoints.far:
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
        self._socket.connect(address)
        liveness = liveness or BrokerLiveness()
        longest = BOUNDS["front"].frame
        self.core = ClientCore(name, self._link, liveness, time.monotonic(), cluster, endpoints.far, longest)
        self._send()

    def step(self, timeout_s: float) -> bool:
        """Send what is to be sent, and handle one message. False if none came in time, or only the connection has
        changed."""
        self._send()
        if not (taken := self.core.take_next(time.monotonic())):
            wait_s = min(timeout_s, self.core.wait_s(time.monotonic()), SILENCE_S)
            ready = dict(self._poller.poll(max(0, math.ceil(1000 * wait_s))))
            now_s = time.monotonic()
            if self._link.monitor in ready and self._link.newly_connected():
                self.core.connected(now_s)
            if self._socket in ready:
                self.core.receive(self._socket.recv_multipart(), now_s)
            self.core.tick(now_s)
            taken = self.core.take_next(now_s)
        self._send()
        return taken

    def exchange(self) -> None:
        """Send what is to be sent, and handle all that has arrived, without waiting. After it one of `descriptors` is
        readable as soon as there is more."""
        while self.step(0.0) or self._poller.poll(0):
            pass

    @property
    def descriptors(self) -> tuple[int, int]:
        """Of the socket and of its monitor, for an event loop."""
        return self._socket.getsockopt(zmq.FD), self._link.monitor.getsockopt(zmq.FD)  # type: ignore[return-value]

    def close(self) -> None:
        self._send()
        self._link.close()
        self._socket.close()

    def _send(self) -> None:
        for parts in self.core.frames_to_send():
            try:
                self._socket.send_multipart(parts, zmq.NOBLOCK)
            except zmq.Again:
                return self.core.queue_is_full()
        return None
