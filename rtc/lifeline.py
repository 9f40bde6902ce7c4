"""A client's sign of life, while its process lives: whoever gave a command with `halt_if_lost` is watched by it.

A thread of its own with a socket of its own, because the client may be busy elsewhere for long. Nothing is answered.
"""

from __future__ import annotations

import threading

import zmq

from rtc import messages as m
from rtc.keys import Doors
from rtc.wire import frames

BEAT_S = 1.0  # the broker gives a client up after five of these


class Lifeline:
    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], doors: Doors, client: str) -> None:
        self._context, self._doors, self._client = context, doors, client
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lifeline", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        with self._context.socket(zmq.DEALER) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.IMMEDIATE, 1)  # never kept for later: life is now
            socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms
            self._doors.secure(socket)
            socket.connect(self._doors.endpoint("front"))
            while not self._over.wait(BEAT_S):
                if socket.poll(0, zmq.POLLOUT):
                    socket.send_multipart(frames(m.Heartbeat(name=self._client)))
