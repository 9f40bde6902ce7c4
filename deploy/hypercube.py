"""The cube of worker nodes: the addresses, and the kind of worker at each. Pure (R147).

The address of a node has `dim` bits. Its two low bits give the kind, the other bits number the replica. So every
sub-cube spanned by the two low dimensions has one worker of each kind. This module knows neither processes nor hosts.
"""

from __future__ import annotations

from collections.abc import Collection

from rtc.protocol.messages import WorkerKind
from rtc.runtime.settings import MAX_DIM, MIN_DIM

KINDS = tuple(WorkerKind)  # the two low bits of an address are an index into this


def kind_of(address: int) -> WorkerKind:
    return KINDS[address & (len(KINDS) - 1)]


def name_of(address: int) -> str:
    """binder@2"""
    return f"{kind_of(address)}@{address}"


def addresses(dim: int) -> range:
    """All addresses of a cube. Raises ValueError unless MIN_DIM <= dim <= MAX_DIM: a smaller cube lacks kinds."""
    if not MIN_DIM <= dim <= MAX_DIM:
        raise ValueError(f"the cube's dimension is {MIN_DIM} to {MAX_DIM}, not {dim}")
    return range(1 << dim)


def replicas(kind: WorkerKind, count: int) -> list[int]:
    """The `count` lowest addresses of a kind."""
    return [KINDS.index(kind) + n * len(KINDS) for n in range(count)]


def next_free(kind: WorkerKind, taken: Collection[int]) -> int:
    """The lowest address of this kind that is not taken; beyond the cube when the cube is full."""
    address = KINDS.index(kind)
    while address in taken:
        address += len(KINDS)
    return address
