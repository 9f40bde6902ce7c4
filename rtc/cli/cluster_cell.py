"""A file of the cell that a broker has sent, for a command that reaches its cluster by a key."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def cell_file(document: bytes) -> Iterator[str]:
    """A temporary file for `Cell.load`. It has no meshes for pictures, which show collision shapes instead."""
    with tempfile.TemporaryDirectory(prefix="rtc-cell-") as folder:
        file = Path(folder) / "cell.yaml"
        file.write_bytes(document)
        yield str(file)
