"""State of a connecting socket, from its monitor: a process listens, the handshake succeeded, the key was refused."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import zmq

from rtc.runtime.process import Process, inbox

WATCHED = zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_DISCONNECTED


class Link:
    """The connection of one socket. After a new connection the peer is probably a new process without our state.

    Make it before the socket connects: a refusal of the key is reported only once. The caller polls `monitor`.
    """

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self.socket = socket
        self.monitor: zmq.Socket[bytes] = socket.get_monitor_socket(WATCHED)
        self.key_refused = False  # the latest handshake was refused: the cluster does not know our key
        self.is_up = False
        self.handshakes = 0  # number of successful ones
        self._listens = False  # over tcp: a process listens there
        self._refusals = 0  # connections that were closed before their handshake had succeeded

    @classmethod
    def connect(
        cls,
        me: Process,
        endpoint: str,
        identity: str = "",
        secure: Callable[[zmq.Socket[Any]], None] | None = None,
        *,
        poll: bool = True,
    ) -> Link:
        """A DEALER to this endpoint and its link, both polled by `me.wait` unless `poll` is False."""
        links: list[Link] = []

        def watch(made: zmq.Socket[Any]) -> None:
            if secure is not None:
                secure(made)
            links.append(cls(made))

        me.socket(zmq.DEALER, endpoint, identity=identity, secure=watch, poll=poll)
        if poll:
            me.poller.register(links[0].monitor, zmq.POLLIN)
        return links[0]

    @property
    def lost(self) -> bool:
        """There was a connection, and there is none now. False before the first: the messages are queued for it."""
        return bool(self.handshakes) and not self.is_up

    @property
    def is_slow(self) -> bool:
        """Over tcp: the other side is there and has refused nothing, so the first answer is only late."""
        return self._listens and not self._refusals and not self.key_refused

    def newly_connected(self) -> bool:
        """Read the events. True if a handshake succeeded since the latest call."""
        before = self.handshakes
        for parts in inbox(self.monitor):
            event, _ = struct.unpack("=HI", parts[0])
            self._listens |= event == zmq.EVENT_CONNECTED
            self.key_refused |= event == zmq.EVENT_HANDSHAKE_FAILED_AUTH
            if event == zmq.EVENT_DISCONNECTED:
                self._refusals += not self.is_up
                self.is_up = False
            if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self.key_refused, self.is_up = False, True
                self.handshakes += 1
        return self.handshakes > before

    def diagnose(self) -> str:
        """The probable reason why a cluster over tcp does not answer."""
        address = self.socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")  # type: ignore[union-attr]
        if self.key_refused:
            return f"the cluster at {address} does not know this key, or it was revoked; there: rtc keys list"
        if self.is_up:
            return f"the gateway at {address} answers, but not its broker; there: rtc status"
        if self.handshakes:
            return f"the connection to {address} is lost: is the cluster still up, and the network?"
        if self._listens:
            return (
                f"the process at {address} is not the cluster of this key file, or has a new key of its own; "
                "make a new key file there: rtc keys new"
            )
        return f"no answer from {address}: is the cluster up, with --listen, and is this the right address?"

    def close(self) -> None:
        """Must be called before the socket is closed, because an open monitor blocks the end of the context."""
        self.socket.disable_monitor()
        self.monitor.close(linger=0)
