"""Heartbeat of a client: sent every second while its process lives, for commands with `halt_if_lost`.

It has a thread and a socket of its own, because the client's thread may be busy for long. The broker does not answer.
"""

from __future__ import annotations

import threading

import zmq

from rtc.protocol import messages as m
from rtc.protocol.wire import frames
from rtc.runtime.keys import Endpoints

BEAT_S = 1.0  # period; the broker treats the client as lost after five missing heartbeats


class HeartbeatSender:
    """Sends `Heartbeat` in the name of `client` from a daemon thread until `close`."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoints: Endpoints, client: str) -> None:
        self._context, self._endpoints, self._client = context, endpoints, client
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and close its socket."""
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        with self._context.socket(zmq.DEALER) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.IMMEDIATE, 1)  # a heartbeat is not queued: an old one would report a dead client
            socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
            self._endpoints.secure(socket)
            socket.connect(self._endpoints.endpoint("front"))
            while not self._over.wait(BEAT_S):
                if socket.poll(0, zmq.POLLOUT):
                    socket.send_multipart(frames(m.Heartbeat(name=self._client)))
