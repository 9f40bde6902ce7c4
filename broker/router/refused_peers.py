"""Peers whose hello was refused, for its version or its name, until they send one that fits. Pure."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, NamedTuple

from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.versions import misfit

MAX_REFUSED = 1_000  # maximum number of peers that stay refused without another hello
SHOWN = 20  # the latest of them, in `rtc status`
STOPS = (m.HaltOrder, m.Shutdown)  # obeyed in every version: they only stop


class RefusedPeer(NamedTuple):
    hello: m.Hello
    refusal: Refusal
    at_s: float


class RefusedPeers:
    def __init__(self) -> None:
        self._refused: OrderedDict[tuple[str, bytes], RefusedPeer] = OrderedDict()  # by socket and peer

    def refusal_of(self, socket: str, peer: bytes, message: Any, now: float) -> Refusal | None:
        """Why this message is refused: a hello of another version, or any message after it."""
        if isinstance(message, m.Hello):
            return self._judge(socket, peer, message, now)
        if not self._refused or isinstance(message, STOPS):
            return None
        known = self._refused.get((socket, peer))
        return known.refusal if known is not None else None

    def is_refused(self, socket: str, peer: bytes) -> bool:
        return (socket, peer) in self._refused

    def rows(self, now: float) -> list[m.RefusedPeerRow]:
        """For `rtc status`, the latest first."""
        return [
            m.RefusedPeerRow(
                name=_name(one.hello),
                socket=socket,
                protocol=one.hello.protocol,
                message=one.refusal.message,
                ago_s=now - one.at_s,
            )
            for (socket, _), one in [*reversed(self._refused.items())][:SHOWN]
        ]

    def _judge(self, socket: str, peer: bytes, hello: m.Hello, now: float) -> Refusal | None:
        self._refused.pop((socket, peer), None)
        words = misfit(_name(hello), hello.protocol, "this cluster")
        if not words:
            return None
        clears = "install one version of rtc on all machines, then rtc down and rtc up"
        refusal = Refusal(reason=RefusalReason.VERSION, message=words, clears=by_person(clears))
        self.refuse(socket, peer, hello, refusal, now)
        return refusal

    def refuse(self, socket: str, peer: bytes, hello: m.Hello, refusal: Refusal, now: float) -> None:
        """Refuse all messages of this peer until its next hello, and show it in `rtc status`."""
        self._refused[socket, peer] = RefusedPeer(hello, refusal, now)
        if len(self._refused) > MAX_REFUSED:
            self._refused.popitem(last=False)


def _name(hello: Any) -> str:
    """The name in a hello, without the random part that a client adds to its own."""
    name: str = hello.client.partition("~")[0] if isinstance(hello, m.ClientHello) else hello.name
    return name
