"""The client of all pages: opened at first use, and again after its cluster is gone. For one event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rtc.client import aio
from rtc.protocol.outcomes import RtcError


class ReopenedClient:
    """`make` makes the client that `take` opens."""

    def __init__(self, make: Callable[[], aio.Client]) -> None:
        self._make = make
        self._client: aio.Client | None = None
        self._opening = asyncio.Lock()

    async def take(self) -> aio.Client:
        """Raises what opening raises: NoCluster and others."""
        async with self._opening:
            try:
                if self._client is not None:
                    self._client.raise_if_lost()
            except RtcError:
                await self.close()
            if self._client is None:
                self._client = await self._make().__aenter__()
            return self._client

    async def close(self) -> None:
        """Close the client, if it is open."""
        client, self._client = self._client, None
        if client is not None:
            await client.__aexit__()
