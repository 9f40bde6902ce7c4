"""What waits for a page: of poses the latest, after those before are acknowledged; of texts all, or all anew."""

from __future__ import annotations

import asyncio

from rtc.apps.console.pages import UNACKNOWLEDGED, UNREAD, FrameSlot, Mailbox


def test_a_slow_page_gets_the_latest_frame_and_none_that_is_late():
    async def play() -> list[bytes]:
        slot = FrameSlot()
        got = []
        for n in range(UNACKNOWLEDGED):
            slot.put(b"%d" % n)
            got.append(await slot.take())
        for n in range(10, 20):  # the page is busy
            slot.put(b"%d" % n)
        waiting = asyncio.create_task(slot.take())
        await asyncio.sleep(0)
        assert not waiting.done()
        slot.acknowledged()
        return [*got, await waiting]

    assert asyncio.run(play()) == [b"0", b"1", b"19"]


def test_texts_arrive_in_order():
    async def play() -> list[bytes]:
        box = Mailbox(lambda: [b"all"])
        box.put(b"1", b"2")
        return [await box.take(), await box.take()]

    assert asyncio.run(play()) == [b"1", b"2"]


def test_a_page_that_does_not_read_gets_everything_anew():
    async def play() -> bytes:
        box = Mailbox(lambda: [b"all"])
        for _ in range(UNREAD + 1):
            box.put(b"1")
        return await box.take()

    assert asyncio.run(play()) == b"all"
