"""Admission: answers the ZAP requests of CURVE handshakes (rfc.zeromq.org/spec/27) by key and role."""

from __future__ import annotations

from collections.abc import Callable

import zmq
from zmq.utils import z85

from broker.gateway.endpoints import HALTS, ServerSockets
from broker.gateway.halt_forwarding import HaltForwarder
from rtc.protocol.roles import a_role, admits
from rtc.runtime.keys import KeyRing, KnownKey
from rtc.runtime.process import Every, Process, inbox

HANDSHAKES = 10  # maximum number per loop iteration
RELOAD_S, EXTRA_RELOADS = 0.2, 10  # period of key reloads, and extra reloads per period for unknown keys


class Admission:
    """`socket`: bound to the address of ZAP before any endpoint. `known`: public key -> key with its name and role.
    `cut` must cut the connections of removed keys."""

    def __init__(
        self,
        me: Process,
        socket: zmq.Socket[bytes],
        ring: KeyRing,
        endpoints: ServerSockets,
        halts: HaltForwarder,
        cut: Callable[[dict[str, KnownKey]], None],
    ) -> None:
        self._me, self._ring, self._endpoints, self._halts = me, ring, endpoints, halts
        self.known = {key.public: key for key in ring.known()}
        self.revoked = {key.public: key for key in ring.revoked()}  # only for messages and counts
        self._cut = cut
        self._reloads, self._reloads_left = Every(RELOAD_S), EXTRA_RELOADS
        self.socket = socket

    def reload_if_due(self, now: float) -> None:
        if self._reloads.due(now):
            self._reloads_left = EXTRA_RELOADS
            self._reload()

    def answer_handshakes(self) -> None:
        for parts in inbox(self.socket, HANDSHAKES):
            version, number, endpoint, where, _, mechanism, *credentials = parts
            public = z85.encode(credentials[0]).decode() if mechanism == b"CURVE" and credentials else ""
            key = self._find(public)
            name, text = endpoint.decode(), b"no key that is known here"
            if key is not None and admits(name, key.role):
                if name in HALTS:
                    self._halts.connect(name, key)
                else:
                    self._me.log.info(
                        "%s (%s) comes from %.60r to %s", key.name, key.role, where.decode("latin-1"), name
                    )
                answer = [b"200", b"", public.encode(), b""]
            else:
                self._refuse(public, key, where.decode("latin-1"), name)
                answer = [b"400", text, b"", b""]
            self.socket.send_multipart([version, number, *answer])

    def _refuse(self, public: str, key: KnownKey | None, host: str, endpoint: str) -> None:
        if key is not None:
            words = f"{a_role(key.role)} may not connect to {endpoint}"
        else:
            words = f"the key is {'revoked' if public in self.revoked else 'not known here'}; it tried {endpoint}"
        self._endpoints.count_refusal("strangers", self.name_of(public), host, words)

    def name_of(self, public: str) -> str:
        """The name of a known or revoked key; empty for any other."""
        key = self.known.get(public) or self.revoked.get(public)
        return key.name if key else ""

    def _find(self, public: str) -> KnownKey | None:
        """The key. An unknown key may be new, so the keys are read again: a refusal would be final."""
        if public not in self.known and self._reloads_left > 0:
            self._reloads_left -= 1
            self._reload()
        return self.known.get(public)

    def _reload(self) -> None:
        """Read the keys. Connections of removed keys are cut before a handshake is answered. The cut renews whole
        endpoints, so a peer that was just admitted would lose the messages it has sent."""
        known = {key.public: key for key in self._ring.known()}
        removed = {public: key for public, key in self.known.items() if known.get(public) != key}
        self.known = known
        if removed:
            self.revoked.update(removed)
            self._cut(removed)
