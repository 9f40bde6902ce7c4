"""The ZeroMQ context of a client, which the garbage collector does not terminate."""

from __future__ import annotations

from typing import Any

import zmq


class ClientContext(zmq.Context[zmq.Socket[Any]]):
    """A context for objects that a user may drop without closing them.

    The collector may delete a context before its sockets. pyzmq then terminates it, and waits for those sockets for
    ever. So `close` of the owner terminates it, or the end of the process.
    """

    def __del__(self) -> None:
        """Leave it to the end of the process."""
