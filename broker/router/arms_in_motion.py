"""Which arms are in motion, sent to the world database after each change: its views mark what they change (R140)."""

from __future__ import annotations

from collections.abc import Callable

from broker.router.core import Core
from rtc.protocol import messages as m
from rtc.world.lease import MOVING, sign

Send = Callable[[m.Moving], object]


class ArmsInMotion:
    """`send`: to the world database. A message that is lost with its process is repeated when the supervisor reports
    that it has ended."""

    def __init__(self, core: Core, send: Send) -> None:
        self._core, self._send = core, send

    def send_changes(self) -> None:
        """Send the arms, if they may have changed since they were last sent."""
        core, state = self._core, self._core.state
        now = (state.motions_begun, state.motions_ended)
        if now != core.motions_stated:
            core.motions_stated = now
            self._send(m.Moving(lease=sign(core.given.lease_key, MOVING, state.motions)))
