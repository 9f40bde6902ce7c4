"""A simulated clock, and sockets between simulated processes that behave as ZeroMQ's do.

A ROUTER knows a peer by its identity while it is connected; what is sent to anybody else is dropped in silence. A
DEALER keeps what it sends while no peer is at the other end, and hands it over when it is connected again. Between two
processes messages keep their order and take their time. What a process had received and not read dies with it.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Sequence
from random import Random
from typing import Any, NamedTuple

import zmq

Frames = Sequence[bytes]
AGAIN = zmq.Again()
START_S = 1000.0  # what the clock shows first


class Frame(NamedTuple):
    """What `recv(copy=False)` gives."""

    bytes: bytes
    more: bool


class Clock:
    """What happens next, and when. The time jumps from one thing to the next."""

    def __init__(self, random: Random) -> None:
        self.now_s = START_S
        self.random = random
        self._heap: list[tuple[float, int, Callable[..., None], tuple[Any, ...]]] = []
        self._count = 0

    def __call__(self) -> float:
        return self.now_s

    def at(self, at_s: float, act: Callable[..., None], *about: Any) -> None:
        self._count += 1
        heapq.heappush(self._heap, (max(at_s, self.now_s), self._count, act, about))

    def after(self, wait_s: float, act: Callable[..., None], *about: Any) -> None:
        self.at(self.now_s + wait_s, act, *about)

    def step(self) -> None:
        """Do the next thing."""
        self.now_s, _, act, about = heapq.heappop(self._heap)
        act(*about)

    def delay_s(self) -> float:
        """Of a message: a fraction of a millisecond, rarely long."""
        random = self.random
        return random.uniform(0.0001, 0.001) if random.random() < 0.97 else random.uniform(0.001, 0.08)


class Router:
    """The bound end of a socket, as far as the broker's shell uses it."""

    def __init__(
        self, clock: Clock, wake: Callable[[], None], sending: Callable[[], None], handover: bool = True
    ) -> None:
        self._clock = clock
        self._wake = wake
        self._sending = sending  # called before anything leaves: a process may die just then
        self.open = True
        self.handover = handover
        self.peers: dict[bytes, Dealer] = {}
        self._inbox: deque[Frame] = deque()
        self._parts: list[bytes] = []

    @property
    def readable(self) -> bool:
        return bool(self._inbox)

    def getsockopt(self, option: int) -> int:
        assert option == zmq.EVENTS
        return int(zmq.POLLIN) if self._inbox else 0

    def recv(self, flags: int = 0, copy: bool = True) -> Frame:
        if not self._inbox:
            raise AGAIN
        return self._inbox.popleft()

    def send(self, part: bytes, flags: int = 0) -> None:
        self._parts.append(part)
        if not flags & zmq.SNDMORE:
            parts, self._parts = self._parts, []
            self.send_multipart(parts)

    def send_multipart(self, parts: Frames, flags: int = 0) -> None:
        self._sending()
        if peer := self.peers.get(parts[0]):
            peer.receive(list(parts[1:]))

    def arrive(self, peer: Dealer, parts: Frames) -> None:
        """From a peer. Its connection may have gone meanwhile: what was on its way comes all the same."""
        if self.open:
            self._inbox.append(Frame(peer.identity, True))
            self._inbox.extend(Frame(part, part is not parts[-1]) for part in parts)
            self._wake()

    def close(self) -> None:
        """The process is dead: what it had not read is gone, and its peers notice."""
        self.open = False
        peers, self.peers = self.peers, {}
        for peer in peers.values():
            peer.lost()


class Dealer:
    """The connecting end: one process's line to a ROUTER, to whatever process is at the other end."""

    def __init__(
        self,
        clock: Clock,
        identity: bytes,
        receive: Callable[[Frames], None],
        connected: Callable[[], None] = lambda: None,
        *,
        immediate: bool = False,
    ) -> None:
        self._clock = clock
        self.identity = identity
        self._receive = receive
        self._connected = connected
        self._immediate = immediate  # nothing is kept for later
        self.router: Router | None = None
        self.dead = False
        self.muted = False  # connected, and another one has its identity: what it sends is dropped
        self._kept: list[Frames] = []
        self._out_s = 0.0  # when the last message of each way arrives: none overtakes it
        self._in_s = 0.0

    def connect(self, router: Router) -> None:
        """With ROUTER_HANDOVER the newer bearer of an identity has it, and without, the older one; the other is mute,
        and does not learn it."""
        if self.dead or not router.open:
            return
        self.router = router
        before = router.peers.get(self.identity)
        if before is not None and not router.handover:
            self.muted = True
            return
        if before is not None:
            before.muted = True
        router.peers[self.identity] = self
        kept, self._kept = self._kept, []
        for parts in kept:
            self.send(parts)
        self._connected()

    def send(self, parts: Frames) -> bool:
        """False: no peer is there, and nothing is kept."""
        if self.router is None:
            if not self._immediate:
                self._kept.append(parts)
            return not self._immediate
        if self.muted:
            return True
        self._out_s = max(self._out_s, self._clock.now_s + self._clock.delay_s())
        self._clock.at(self._out_s, self.router.arrive, self, parts)
        return True

    def receive(self, parts: Frames) -> None:
        self._in_s = max(self._in_s, self._clock.now_s + self._clock.delay_s())
        self._clock.at(self._in_s, self._deliver, parts)

    def lost(self) -> None:
        self.router = None
        self.muted = False

    def close(self) -> None:
        """The process is dead."""
        self.dead = True
        if self.router is not None and self.router.peers.get(self.identity) is self:
            del self.router.peers[self.identity]
        self.router = None

    def _deliver(self, parts: Frames) -> None:
        if not self.dead:
            self._receive(parts)
