"""Which arms are in motion, stated to the world database after each change: its views mark what they change (R140)."""

from __future__ import annotations

from broker.router.core import Core


class ArmsInMotion:
    """The statement is in the memory that the supervisor hands to its processes, so it survives them."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._stated: tuple[int, int] | None = None  # counts of motions begun and ended

    def state_changes(self) -> None:
        """State the arms, if they may have changed since they were last stated."""
        state = self._core.state
        now = (state.motions_begun, state.motions_ended)
        if now != self._stated:
            self._stated = now
            self._core.given.state_motions(state.motions)
