"""What waits for one open page: the latest frame of poses, and a bounded queue of texts. For one event loop.

A frame is sent only after the page has acknowledged the one before, so a slow page gets the latest and none late. A
text is never skipped: a page whose queue is full gets everything anew.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable

UNREAD = 300  # maximum number of texts
UNACKNOWLEDGED = 2  # frames under way to a page


class FrameSlot:
    """The latest frame for one page."""

    def __init__(self) -> None:
        self._frame: bytes | None = None
        self._sent = 0
        self._ready = asyncio.Event()

    def put(self, frame: bytes) -> None:
        self._frame = frame
        self._wake()

    def acknowledged(self) -> None:
        self._sent = max(0, self._sent - 1)
        self._wake()

    async def take(self) -> bytes:
        """The latest frame that the page has not had, once it has acknowledged those before."""
        await self._ready.wait()
        frame, self._frame = self._frame, None
        assert frame is not None
        self._sent += 1
        self._wake()
        return frame

    def _wake(self) -> None:
        if self._frame is not None and self._sent < UNACKNOWLEDGED:
            self._ready.set()
        else:
            self._ready.clear()


class Mailbox:
    """Texts for one page. `anew`: everything that a page needs from the start."""

    def __init__(self, anew: Callable[[], Iterable[bytes]]) -> None:
        self._anew = anew
        self._texts: deque[bytes] = deque()
        self._ready = asyncio.Event()

    def put(self, *texts: bytes) -> None:
        self._texts.extend(texts)
        if len(self._texts) > UNREAD:
            self._texts = deque(self._anew())
        if self._texts:
            self._ready.set()

    async def take(self) -> bytes:
        while not self._texts:
            self._ready.clear()
            await self._ready.wait()
        return self._texts.popleft()
