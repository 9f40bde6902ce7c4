"""The client of the world database, with a limit on each wait.

Reads and commits are idempotent, so a request without an answer is sent again, for example after a server restart.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable
from typing import Any

import msgspec
import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, Refusal, RtcError, WireError
from rtc.runtime import process
from rtc.runtime.process import now_s
from rtc.world.model import as_changing

FIRST_TRY_S, MAX_TRY_S = 0.04, 0.5  # wait per attempt: doubled after each, up to the longest
LIMIT_S = 5.0  # longer than a restart of the server
ROUND_TRIPS = 6  # over tcp: those of a handshake, and that of the question

_read = wire.reader(m.FromWorld)


class WorldClient:
    """One connection, for one thread. `endpoint` is the endpoint "world" of the cluster."""

    def __init__(
        self,
        endpoint: str,
        context: zmq.Context[Any] | None = None,
        limit_s: float = LIMIT_S,
        secure: process.Secure = None,
        round_trip_s: float = 0.0,
    ) -> None:
        self._context = context or zmq.Context.instance()
        name = "" if secure else f"w{os.urandom(8).hex()}"  # over tcp the gateway assigns the identity
        self._socket = process.open_socket(self._context, zmq.DEALER, endpoint, identity=name, secure=secure)
        self._numbers = itertools.count(1)
        self._limit_s, self._round_trip_s = limit_s + ROUND_TRIPS * round_trip_s, round_trip_s

    def view(self, since: int = 0, keys: Iterable[str] | None = None) -> m.View:
        """The facts newer than version `since`, all or those of some keys or locations, from one version of the world.
        Those that an arm in motion changes are changing.

        Raises ClusterError without an answer within the limit.
        """
        stored = self.stored(since, keys)
        if not stored.changing:
            return stored
        return msgspec.structs.replace(stored, facts=as_changing(stored.facts, stored.changing))

    def stored(self, since: int = 0, keys: Iterable[str] | None = None) -> m.View:
        """As `view`, with the stored validity of all facts: for a reader that keeps them for its next read."""
        wanted = None if keys is None else list(keys)
        answer = self._ask(m.ReadView(request=self._request(), keys=wanted, since=since))
        return _expect(answer, m.View)

    def history(self, key: str, limit: int = 100) -> list[m.Fact]:
        """The past and present facts of this key, newest first. Raises ClusterError as `view` does."""
        return _expect(self._ask(m.WorldHistory(request=self._request(), key=key, limit=limit)), m.View).facts

    def commit(self, lease: m.Lease, changes: list[m.WorldChange], source: str) -> m.Committed | Refusal:
        """Writes under a lease; a job writes once even if sent twice. Raises ClusterError as `view` does."""
        answer = self._ask(m.Commit(request=self._request(), lease=lease, changes=changes, source=source))
        return answer.refusal if isinstance(answer, m.WorldRefused) else _expect(answer, m.Committed)

    def doubt(self, lease: m.Lease, why: str) -> None:
        """Makes facts that a motion changes suspect: those of the lease's locations, or all, if the lease is of the
        broker itself. Raises ClusterError as `view` does, and if the lease is refused."""
        _expect(self._ask(m.Doubt(request=self._request(), lease=lease, why=why)), m.Committed)

    def close(self) -> None:
        self._socket.close()

    def _request(self) -> str:
        return str(next(self._numbers))

    def _ask(self, message: Any) -> Any:
        end_s, try_s = now_s() + self._limit_s, FIRST_TRY_S
        while (left_s := end_s - now_s()) > 0:
            process.send(self._socket, message)
            answer = self._answer_to(message.request, min(try_s + self._round_trip_s, left_s))
            if answer is not None:
                return answer
            try_s = min(2 * try_s, MAX_TRY_S)
        raise ClusterError(f"the world database did not answer within {self._limit_s:g} s")

    def _answer_to(self, request: str, try_s: float) -> Any:
        end_s = now_s() + try_s
        while (left_s := end_s - now_s()) > 0:
            self._socket.setsockopt(zmq.RCVTIMEO, int(1000 * left_s + 0.999))
            try:
                answer = _read(self._socket.recv_multipart())
            except zmq.Again:
                return None
            except WireError:
                continue
            if answer.request == request:  # otherwise a late answer to another request
                return answer
        return None


def _expect(answer: Any, kind: Any) -> Any:
    if isinstance(answer, kind):
        return answer
    got = answer.refusal.message if isinstance(answer, m.WorldRefused) else type(answer).__name__
    raise RtcError(f"the world database answered {got!r} instead of a {kind.__name__}")
