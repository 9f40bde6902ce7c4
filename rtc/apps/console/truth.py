"""A thread that asks the simulator for the true scene while a page is open. Real arms have none, and never answer."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

import zmq

from rtc.client.context import ClientContext
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError
from rtc.runtime.process import open_socket, send
from rtc.runtime.settings import Settings

MOVING_S, STILL_S = 0.04, 0.5  # pause between two questions, while an arm moves and otherwise
ANSWER_MS = 500

_read = wire.reader(m.FromSim)


class TruthReader:
    """Calls `take` in its own thread. `wanted`: a page is open; `moving`: an arm moves."""

    def __init__(
        self,
        settings: Settings,
        take: Callable[[m.SimTruthReply], None],
        wanted: Callable[[], bool],
        moving: Callable[[], bool],
    ) -> None:
        self._endpoint = settings.endpoint("bench")
        self._take, self._wanted, self._moving = take, wanted, moving
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        context = ClientContext()
        with open_socket(context, zmq.DEALER, self._endpoint) as socket:
            for n in itertools.count(1):
                if self._over.wait(MOVING_S if self._moving() else STILL_S):
                    break
                if self._wanted():
                    self._ask(socket, str(n))
        context.destroy(linger=0)

    def _ask(self, socket: zmq.Socket[bytes], request: str) -> None:
        send(socket, m.SimTruth(request=request))
        while socket.poll(ANSWER_MS):
            try:
                answer = _read(socket.recv_multipart())
            except WireError:
                continue
            if isinstance(answer, m.SimTruthReply) and answer.request == request:
                self._take(answer)
                return
