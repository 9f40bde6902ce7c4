"""What outlives its controller: where arms, fingers and things are, kept so that a new MCM process finds them there.

A real arm whose computer dies stands braked where it was, and its hand keeps its grip. A simulated one would be back in
its first posture, with everything in its first seat, and the world database would believe what was never undone. So the
simulator writes its state down, between ticks and before every end report, and its successor begins with it, at rest.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from sim_mcm.arm import CellState

FILE = "hardware.bin"  # in the run directory


class StateFile:
    """One file of one run of the cluster: length, then body, written in one call, so it is whole whoever is killed."""

    def __init__(self, run_dir: Path, run: str) -> None:
        self._run = run
        self._fd = os.open(run_dir / FILE, os.O_RDWR | os.O_CREAT, 0o600)
        self._encode = msgspec.msgpack.Encoder().encode

    def load(self) -> CellState | None:
        """What the process before us left; None when there was none in this run, or what lies there is no state."""
        kept = os.pread(self._fd, os.fstat(self._fd).st_size, 0)
        length = int.from_bytes(kept[:4], "little")
        try:
            run, state = msgspec.msgpack.decode(kept[4 : 4 + length], type=tuple[str, CellState])
        except msgspec.DecodeError:  # ours is always whole: it is of another version, or of nobody we know
            return None
        return state if run == self._run else None

    def save(self, state: CellState) -> None:
        body = self._encode((self._run, state))
        os.pwrite(self._fd, len(body).to_bytes(4, "little") + body, 0)
