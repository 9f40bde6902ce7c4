"""The process table: `supervisor.json` in the run directory, one row for each process of the cluster.

The supervisor writes it every second and at each change. All other readers use the broker's status, or this file when
the broker is away.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

import msgspec

from rtc.protocol.messages import ProcessRow
from rtc.protocol.outcomes import NoCluster
from rtc.runtime.settings import shell_command

FILE = "supervisor.json"  # in the run directory


class Table(msgspec.Struct, frozen=True, kw_only=True):
    """The supervisor and its processes."""

    pid: int = 0  # of the supervisor
    cluster: str = ""  # identity of the run
    started_at: float = 0.0  # seconds since 1970
    processes: list[ProcessRow] = []

    def save(self, run_dir: Path) -> None:
        """Replace the file atomically: a reader always sees a whole table. Raises OSError."""
        path = run_dir / FILE
        aside = path.with_suffix(".new")
        aside.write_bytes(msgspec.json.format(msgspec.json.encode(self)))
        os.replace(aside, path)

    @staticmethod
    def load(run_dir: Path) -> Table | None:
        """The table in `run_dir`; None if there is none or it cannot be read."""
        try:
            return msgspec.json.decode((run_dir / FILE).read_bytes(), type=Table)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            return None


def processes(run_dir: Path) -> dict[str, ProcessRow]:
    """The cluster's processes by name. Raises NoCluster if there is no readable table."""
    table = Table.load(run_dir)
    if table is None:
        raise NoCluster(f"no cluster is running in {run_dir}; start one with: {shell_command('rtc up -d', run_dir)}")
    return {row.name: row for row in table.processes}


def supervisor_pid(run_dir: Path) -> int | None:
    """Process id of the supervisor, as it wrote it; the process may have ended since. None if there is none."""
    table = Table.load(run_dir)
    return table.pid if table is not None and table.pid > 0 else None


def in_words(status: int) -> str:
    """An exit status for people: `was killed by SIGKILL`, `ended with status 1`."""
    if status < 0:
        known = -status in {one.value for one in signal.Signals}
        return f"was killed by {signal.Signals(-status).name if known else f'signal {-status}'}"
    return f"ended with status {status}"
