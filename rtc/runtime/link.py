"""State of a connecting socket, from its monitor: a process listens, the handshake succeeded, the key was refused."""

from __future__ import annotations

import struct
from typing import Any

import zmq

from rtc.runtime.process import Process, inbox

WATCHED = zmq.EVENT_CONNECTED | zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_DISCONNECTED


class LinkState:
    """What the events of a monitor say about one connection."""

    def __init__(self) -> None:
        self.key_refused = False  # the latest handshake was refused: the cluster does not know our key
        self.is_up = False
        self.handshakes = 0  # number of successful ones
        self._listens = False  # over tcp: a process listens there

    def take(self, parts: Any) -> bool:
        """Read one event of the monitor. True if a handshake succeeded."""
        event, _ = struct.unpack("=HI", parts[0])
        self._listens |= event == zmq.EVENT_CONNECTED
        self.key_refused |= event == zmq.EVENT_HANDSHAKE_FAILED_AUTH
        if event == zmq.EVENT_DISCONNECTED:
            self.is_up = False
        if event != zmq.EVENT_HANDSHAKE_SUCCEEDED:
            return False
        self.key_refused, self.is_up = False, True
        self.handshakes += 1
        return True

    def diagnose(self, address: str) -> str:
        """The probable reason why a cluster over tcp does not answer."""
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


class Link:
    """Watches a connecting socket of a process. After a reconnection the peer is probably a new process without our
    state."""

    def __init__(self, me: Process, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self._monitor = socket.get_monitor_socket(WATCHED)
        self._state = LinkState()
        self._first = True
        me.poller.register(self._monitor, zmq.POLLIN)

    def reconnected(self) -> bool:
        """Read the events. True once after each reconnection; the first connection does not count."""
        found = sum(self._state.take(parts) for parts in inbox(self._monitor))
        again, self._first = found > (1 if self._first else 0), self._first and not found
        return again

    @property
    def key_refused(self) -> bool:
        return self._state.key_refused

    def diagnose(self) -> str:
        """The probable reason why a cluster over tcp does not answer."""
        address = self._socket.getsockopt(zmq.LAST_ENDPOINT)
        return self._state.diagnose(address.decode().rstrip("\0") if isinstance(address, bytes) else "")

    def close(self) -> None:
        """Must be called before the context ends, because an open monitor blocks its end."""
        self._socket.disable_monitor()
        self._monitor.close(linger=0)
