"""The stream of an operator's hand to a granted arm: `Client.hand`.

    with Client() as client, client.hand("RIGHT-ARM", "ADA") as hand:
        print(hand.request)
        hand.move([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])  # 50 times per second while the deadman is held
        hand.release()

Each message carries the latest time that this process has seen of the subsystem, so one that was delayed does nothing.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Literal

import zmq

from rtc.client.context import ClientContext
from rtc.protocol import messages as m
from rtc.protocol.outcomes import ClusterError, WireError
from rtc.protocol.wire import frames, reader
from rtc.runtime.keys import Endpoints

PERIOD_S = 0.02  # between two messages
FIRST_S = 1.0  # maximum wait for the first telemetry of the arm
ROUND_TRIPS = 6  # over tcp in addition: those of a handshake
STILL = (0.0,) * 6

_read_reply = reader(m.OperateReply)
_read_telemetry = reader(m.Telemetry)


class HandController:
    """One arm; one thread. `state` is the latest measurement of the arm, `reply` the latest answer."""

    def __init__(
        self, context: ClientContext, endpoints: Endpoints, arm: str, operator: str, round_trip_s: float = 0.0
    ) -> None:
        self.arm, self.operator = arm, operator
        self.state: m.ArmSample | None = None
        self.reply: m.OperateReply | None = None
        self._context, self._endpoints = context, endpoints
        endpoints.endpoint("operate")  # raises if the key has not this right
        self._seen_at_s = 0.0
        self._first_s = FIRST_S + ROUND_TRIPS * round_trip_s
        self._telemetry: zmq.Socket[Any] = context.socket(zmq.SUB)
        self._telemetry.subscribe(b"")
        endpoints.secure(self._telemetry)
        for address in endpoints.addresses("telemetry").values():
            self._telemetry.connect(address)
        self._socket: zmq.Socket[Any] | None = None  # of the subsystem of the arm, once it is known
        self._look(self._first_s)
        if self.state is None:
            self.close()
            raise ClusterError(f"no telemetry of {arm}: see its name in rtc status, and whether its subsystem runs")

    def __enter__(self) -> HandController:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        self.release()
        self.close()

    @property
    def operation(self) -> m.TeleopState | None:
        """What the operator may do with the arm now; None: nothing."""
        self._look(0.0)
        return self.state.operation if self.state is not None else None

    @property
    def request(self) -> str:
        """What the operator is asked to do; empty: nothing."""
        return operation.request if (operation := self.operation) is not None else ""

    def move(
        self,
        twist: Sequence[float] = STILL,
        *,
        frame: Literal["tool", "world"] = "world",
        hand: Literal["", "open", "close"] = "",
        turn: float = 0.0,
    ) -> str:
        """Move the arm for this moment: tcp velocity (m/s, rad/s), fingers, share of the spindle's speed. Returns why
        the latest message that was answered did nothing; empty: it counts. Call it every PERIOD_S."""
        return self._send(twist=list(twist), frame=frame, hand=hand, turn=turn, hold=True)

    def release(self) -> str:
        """Let go: the arm stops."""
        return self._send(hold=False)

    def close(self) -> None:
        for socket in (self._telemetry, self._socket):
            if socket is not None:
                socket.close(linger=100)

    def _send(self, **wanted: Any) -> str:
        if self.operation is None or self.state is None or self._socket is None:
            return f"{self.arm} is not the operator's now"
        message = m.Operate(primitive=self.state.primitive, operator=self.operator, seen_at_s=self._seen_at_s, **wanted)
        try:
            self._socket.send_multipart(frames(message), zmq.NOBLOCK)
        except zmq.Again:
            return f"the subsystem of {self.arm} is not connected, or takes nothing now: it stops by itself"
        self._take_replies()
        return self.reply.refused if self.reply is not None else ""

    def _look(self, limit_s: float) -> None:
        """Take the telemetry that is there; the first is waited for."""
        end_s = time.monotonic() + limit_s
        while self._telemetry.poll(int(1000 * max(0.0, end_s - time.monotonic())) if self.state is None else 0):
            try:
                seen = _read_telemetry(self._telemetry.recv_multipart())
            except WireError:
                continue
            if self.arm in seen.arms:
                self.state, self._seen_at_s = seen.arms[self.arm], max(self._seen_at_s, seen.at_s)
                self._connect(seen.subsystem)

    def _connect(self, subsystem: str) -> None:
        if self._socket is None:
            self._socket = self._context.socket(zmq.DEALER)
            self._socket.setsockopt(zmq.SNDHWM, 4)  # what waits is stale
            self._socket.setsockopt(zmq.IMMEDIATE, 1)
            self._endpoints.secure(self._socket)
            addresses = self._endpoints.addresses("operate")
            self._socket.connect(addresses.get(subsystem) or addresses[""])
            self._socket.poll(int(1000 * self._first_s), zmq.POLLOUT)

    def _take_replies(self) -> None:
        assert self._socket is not None
        while self._socket.poll(0):
            try:
                self.reply = _read_reply(self._socket.recv_multipart())
            except WireError:
                continue
            self._seen_at_s = max(self._seen_at_s, self.reply.at_s)
