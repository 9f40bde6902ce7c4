"""The client of all pages of a console, against a small broker."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from rtc.apps.console.reopened import ReopenedClient
from rtc.client import aio
from rtc.protocol.outcomes import NoCluster
from tests.client.test_client import SmallBroker, accepting, broker, obliging, of_cluster, run_dir  # noqa: F401


def test_one_client_serves_requests_at_the_same_time(broker: SmallBroker, run_dir: Path) -> None:  # noqa: F811
    async def use() -> None:
        client = ReopenedClient(lambda: aio.Client(run_dir))
        first, second = await asyncio.gather(client.take(), client.take())
        assert first is second
        ends = await asyncio.gather(*(first.run(f"STOW {n}", 5.0) for n in (1, 2)))
        assert [end.command for end in ends] == ["C-1", "C-2"]
        await client.close()
        await client.close()  # it is closed

    asyncio.run(use())


def test_a_client_whose_cluster_is_gone_is_opened_again(run_dir: Path) -> None:  # noqa: F811
    async def use() -> None:
        first = SmallBroker(run_dir, of_cluster("old", accepting))
        client = ReopenedClient(lambda: aio.Client(run_dir))
        lost = await client.take()
        command = await lost.submit("STOW 1")
        await asyncio.to_thread(first.stop)
        second = SmallBroker(run_dir, of_cluster("new", obliging))
        with pytest.raises(NoCluster):
            await command.wait(10.0)
        again = await client.take()
        assert again is not lost
        assert (await again.run("STOW 2", 5.0)).command == "C-2"
        await client.close()
        await asyncio.to_thread(second.stop)

    asyncio.run(use())


def test_what_opening_raises_is_raised_each_time(tmp_path: Path) -> None:
    async def use() -> None:
        client = ReopenedClient(lambda: aio.Client(tmp_path / "nowhere"))
        for _ in range(2):
            with pytest.raises(NoCluster):
                await client.take()
        await client.close()

    asyncio.run(use())
