"""The state file: positions of arms, fingers and objects, so that a new MCM process continues from them.

If a real arm's computer fails, brakes hold the arm and the hand keeps its grip. A simulated arm would return to its
initial posture and every object to its initial seat, so the world database would be wrong. Therefore the simulator
saves its state between ticks and before every end report. The next process restores it, at rest.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from rtc.subsystems.motion.arm import CellState

FILE = "hardware-{}.bin"  # in the run directory, of a subsystem


class StateFile:
    """The state file of one run of the cluster: length, then body, written in one call, so a kill cannot split it."""

    def __init__(self, run_dir: Path, run: str, subsystem: str) -> None:
        self._run = run
        self._fd = os.open(run_dir / FILE.format(subsystem), os.O_RDWR | os.O_CREAT, 0o600)
        self._encode = msgspec.msgpack.Encoder().encode

    def load(self) -> CellState | None:
        """The state that the previous process saved; None if this run has none or the file does not decode."""
        kept = os.pread(self._fd, os.fstat(self._fd).st_size, 0)
        length = int.from_bytes(kept[:4], "little")
        try:
            run, state = msgspec.msgpack.decode(kept[4 : 4 + length], type=tuple[str, CellState])
        except msgspec.DecodeError:  # our own writes are whole: the file is of another version or origin
            return None
        return state if run == self._run else None

    def save(self, state: CellState) -> None:
        body = self._encode((self._run, state))
        os.pwrite(self._fd, len(body).to_bytes(4, "little") + body, 0)
