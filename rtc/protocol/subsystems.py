"""The subsystems of a cluster, as data: who performs an arm or a camera, and what the supervisor starts for it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta


class Subsystem(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """One subsystem: a process that performs primitives for some arms or cameras."""

    name: Annotated[str, Meta(pattern=r"^[A-Z][A-Z0-9&-]{0,30}$")]  # its identity at the broker
    performers: list[str] = []  # arms or cameras of the cell
    module: str = ""  # Python module that the supervisor runs, with --run-dir and --name; empty: others start it
    estop: bool = False  # it binds a socket for halts of its own, which works without the broker


#: of a cell that names none; the first performs arms, the second cameras
DEFAULTS = msgspec.json.decode(Path(__file__).with_suffix(".json").read_bytes(), type=tuple[Subsystem, ...])
ARMS, CAMERAS = DEFAULTS


def resolved(named: list[Subsystem], arms: list[str], cameras: list[str]) -> list[Subsystem]:
    """The subsystems of a cell. Arms and cameras that it gives to none belong to those of `DEFAULTS`."""
    given = {performer for one in named for performer in one.performers}
    left = [
        msgspec.structs.replace(ARMS, performers=[arm for arm in arms if arm not in given]),
        msgspec.structs.replace(CAMERAS, performers=[camera for camera in cameras if camera not in given]),
    ]
    names = {one.name for one in named}
    return [*(one for one in left if one.name not in names and (one.performers or not one.estop)), *named]


def owner(subsystems: list[Subsystem], performer: str) -> str:
    """The name of the subsystem of an arm or a camera. Raises KeyError."""
    for one in subsystems:
        if performer in one.performers:
            return one.name
    raise KeyError(performer)
