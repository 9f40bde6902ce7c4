"""The taught places of a cell, kept for the next runs in a file of the user; one file for each name of a cell.

`rtc teach` writes it; the world database reads it when it begins.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from rtc.model.cells.cell import Cell
from rtc.model.cells.taught import Postures, taken
from rtc.runtime import environment


def file_of(cell: Cell) -> Path:
    safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in cell.name)
    return Path(environment.data_dir()) / "places" / f"{safe}.json"


def load(cell: Cell) -> Postures:
    """Those that fit this cell. Raises OSError, msgspec.MsgspecError."""
    try:
        body = file_of(cell).read_bytes()
    except FileNotFoundError:
        return {}
    joints = {arm.name: len(arm.joints) for arm in cell.arms}
    kept = {
        name: {arm: values for arm, values in by_arm.items() if joints.get(arm) == len(values)}
        for name, by_arm in msgspec.json.decode(body, type=Postures).items()
        if not taken(cell, name)
    }
    return {name: by_arm for name, by_arm in kept.items() if by_arm}


def save(cell: Cell, known: Postures) -> Path:
    """Replace the file. Raises OSError."""
    file = file_of(cell)
    file.parent.mkdir(parents=True, exist_ok=True)
    new = file.with_suffix(".new")
    new.write_bytes(msgspec.json.format(msgspec.json.encode(known), indent=2))
    new.replace(file)
    return file
