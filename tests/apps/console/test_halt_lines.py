"""The lines of pages to broker and MCM: how often each one sends."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

from rtc.apps.console.halt_lines import HaltLines
from rtc.runtime.halt_admission import PER_S
from rtc.runtime.settings import Settings
from tests.client.test_client import SmallBroker, obliging


def test_no_page_makes_a_line_send_more_than_subsystems_confirm(tmp_path: Path) -> None:
    Settings(run_dir=str(tmp_path)).save()
    broker = SmallBroker(tmp_path, obliging)
    count = PER_S // 4

    async def flood() -> list[bool]:
        halts = HaltLines(Settings.load(tmp_path), ["RIGHT-ARM"])
        found = [(await halts.order("C-1"))["confirmed"] for _ in range(count)]  # one line has these scopes
        halts.close()
        return found

    began_s = time.monotonic()
    assert all(asyncio.run(flood()))
    assert time.monotonic() - began_s > (count - 1) / PER_S
    broker.stop()
