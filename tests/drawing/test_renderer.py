"""The process that draws, as its client starts it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rtc.drawing.renderer import Renderer


def test_the_renderer_has_a_session_with_its_niceness() -> None:
    """Inside the session of a shell its niceness would count for nothing where sessions share the processors."""
    with Renderer(5) as renderer:
        process = renderer._process.pid
        assert os.getsid(process) == process
        group = Path(f"/proc/{process}/autogroup")
        if not group.exists():
            pytest.skip("a system without autogroups")
        wanted = min(19, os.getpriority(os.PRIO_PROCESS, 0) + 5)
        assert group.read_text().split()[-1] == str(wanted)
