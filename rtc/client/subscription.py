"""Subscriptions of a client: events of the broker, telemetry of the arms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import zmq

from rtc.client.context import ClientContext
from rtc.protocol.outcomes import WireError
from rtc.protocol.wire import MAX_BYTES
from rtc.runtime.keys import Endpoints

Published = TypeVar("Published")


def subscribe(
    context: ClientContext,
    endpoints: Endpoints,
    endpoint: str,
    read: Callable[[Sequence[bytes]], Published],
    silence_s: float | None,
) -> Iterator[Published]:
    """All messages from now on; endless, or until none has come for `silence_s`."""
    return _each(subscribed(context, endpoints, endpoint), read, silence_s)


def subscribed(context: ClientContext, endpoints: Endpoints, endpoint: str) -> zmq.Socket[bytes]:
    """The socket of a new subscription."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)
    socket.subscribe(b"")
    endpoints.secure(socket)
    for address in endpoints.addresses(endpoint).values():
        socket.connect(address)
    return socket


def _each(
    socket: zmq.Socket[bytes], read: Callable[[Sequence[bytes]], Published], silence_s: float | None
) -> Iterator[Published]:
    limit_ms = None if silence_s is None else int(silence_s * 1000)
    with socket:
        while socket.poll(limit_ms):
            try:
                yield read(socket.recv_multipart())
            except WireError:
                continue  # of a newer version
