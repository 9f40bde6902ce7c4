"""End of the cluster: halt everything, and report to the supervisor when every command has ended."""

from __future__ import annotations

from broker.router.core import Core
from broker.router.egress import Egress
from broker.router.halt_intake import HaltIntake
from rtc.protocol import messages as m


class ClusterShutdown:
    def __init__(self, core: Core, egress: Egress, halts: HaltIntake) -> None:
        self._core, self._egress, self._halts = core, egress, halts
        self._commands: list[str] | None = None  # live when the end began
        self._arms: set[str] = set()  # in motion when the end began

    @property
    def begun(self) -> bool:
        return self._commands is not None

    def begin(self, now: float) -> None:
        """Halt everything. A repeated order only repeats the report."""
        if self._commands is not None:
            self.report()
            return
        live = self._core.state.commands
        self._core.me.log.info("the cluster is being stopped; %d commands are live", len(live))
        self._commands = list(live)
        self._halts.enqueue("supervisor", m.HaltOrder(halt=self._halts.end_halt, called_at_s=now), now)

    def record_motion(self, message: m.HaltStarted) -> None:
        """Record which arms this halt stopped."""
        if message.halt == self._halts.end_halt:
            self._arms.update(message.moving)

    def report(self) -> None:
        """Report the end to the supervisor, once no command is live."""
        if self._commands is not None and not self._core.state.commands:
            self._egress.send_supervisor(m.AllEnded(commands=self._commands, arms=sorted(self._arms)))
