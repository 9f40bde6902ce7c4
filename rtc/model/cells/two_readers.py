"""Whether physics reads a URDF as planning does: the question to the process that has both readers, and its answer.

pybullet belongs to `sim_mcm`, so `sim_mcm.arms.readers` compares, in a process of its own.
"""

from __future__ import annotations

import subprocess
import sys
from functools import lru_cache
from typing import NamedTuple

import msgspec

from rtc.protocol.outcomes import RtcError

COMMAND = [sys.executable, "-P", "-m", "sim_mcm.arms.readers"]
LIMIT_S = 60.0  # on a slow, busy machine; it takes about a second


class ReaderDifference(NamedTuple):
    where: str  # link NAME or joint NAME
    problem: str
    expected: str


class ReaderInput(msgspec.Struct, frozen=True):
    """`hulls`: texts by file name; `shapes`: whether collision shapes are compared, too."""

    urdf: str
    hulls: dict[str, str]
    shapes: bool


class Answer(msgspec.Struct, frozen=True):
    differences: list[ReaderDifference]


def differences(urdf: str, hulls: dict[str, str], shapes: bool) -> list[ReaderDifference]:
    """All values that pinocchio and Bullet read differently. Raises RtcError if there is no answer."""
    return _answer(msgspec.json.encode(ReaderInput(urdf, hulls, shapes)) + b"\n").differences


@lru_cache(maxsize=16)
def _answer(line: bytes) -> Answer:
    """Of a question, encoded. A new cell is asked about when it is drafted and when it is reviewed."""
    try:
        ended = subprocess.run(COMMAND, input=line, capture_output=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        raise RtcError(f"the two readers of the URDF were not compared within {LIMIT_S:.0f} s: try again") from None
    answers = [line for line in ended.stdout.splitlines() if line.startswith(b'{"differences"')]
    if not answers:
        last = ended.stderr.decode(errors="replace").strip().splitlines()
        raise RtcError(f"{' '.join(COMMAND[3:])} has ended: {last[-1] if last else 'is pybullet installed?'}")
    return msgspec.json.decode(answers[-1], type=Answer)
