"""The cell of a cluster: its name in a run directory, or the file that a broker has sent to the user of a key."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from rtc.runtime.settings import Settings, default_run_dir

CELL = "swapout"  # default cell of a cluster


def cell_of(run_dir: Path | None) -> str:
    """Name or file of the cell of the cluster that runs, or ran last, in this directory; None: the user's own."""
    try:
        return Settings.load(run_dir or default_run_dir()).cell
    except (OSError, msgspec.MsgspecError):
        return CELL


@contextmanager
def cell_file(document: bytes) -> Iterator[str]:
    """A temporary file for `Cell.load`. It has no meshes for pictures, which show collision shapes instead."""
    with tempfile.TemporaryDirectory(prefix="rtc-cell-") as folder:
        file = Path(folder) / "cell.yaml"
        file.write_bytes(document)
        yield str(file)
