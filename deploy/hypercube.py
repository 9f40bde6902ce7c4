"""The cube of worker nodes: addresses, what each is, who is next to whom, and the way between two. Pure (R147).

A node's address is a number of `dim` bits. Its two low bits say its kind, the rest which replica it is, so every
sub-cube spanned by the two low dimensions has one worker of each kind. Nothing here knows processes or hosts.
"""

from __future__ import annotations

from collections.abc import Collection

from rtc.messages import WorkerKind

KINDS = tuple(WorkerKind)  # the two low bits of an address are the place in here
KIND_BITS = 2
LEAST_DIM, MOST_DIM = KIND_BITS, 8


def kind_of(address: int) -> WorkerKind:
    return KINDS[address & (len(KINDS) - 1)]


def name_of(address: int) -> str:
    """binder@2"""
    return f"{kind_of(address)}@{address}"


def address_of(name: str) -> int:
    """2 of binder@2. Raises ValueError for a name that no node bears."""
    _, _, number = name.partition("@")
    address = int(number)
    if name_of(address) != name:
        raise ValueError(f"no node is called {name}: address {address} is {name_of(address)}")
    return address


def addresses(dim: int) -> range:
    """All addresses of a cube. Raises ValueError for a dimension that has not all four kinds, or is too great."""
    if not LEAST_DIM <= dim <= MOST_DIM:
        raise ValueError(f"the cube's dimension is {LEAST_DIM} to {MOST_DIM}, not {dim}")
    return range(1 << dim)


def replicas(kind: WorkerKind, count: int) -> list[int]:
    """The lowest addresses of a kind."""
    return [KINDS.index(kind) + n * len(KINDS) for n in range(count)]


def neighbours(address: int, dim: int) -> list[int]:
    """The nodes one bit away, lowest dimension first."""
    return [address ^ (1 << bit) for bit in range(dim)]


def half_cubes(dim: int) -> tuple[list[int], list[int]]:
    """(for live work, for hypothesis tests): the halves of the highest dimension, each with all four kinds (R142).
    A cube that has every kind once cannot be halved: all of it serves both."""
    whole = list(addresses(dim))
    if dim == LEAST_DIM:
        return whole, whole
    return whole[: len(whole) // 2], whole[len(whole) // 2 :]


def route(start: int, end: int) -> list[int]:
    """The nodes on the way from one to another, both included: differing bits put right from the lowest up
    (dimension-order), which cannot deadlock, and is a shortest way."""
    way = [start]
    differing = start ^ end
    for bit in range(differing.bit_length()):
        if differing >> bit & 1:
            way.append(way[-1] ^ (1 << bit))
    return way


def next_free(kind: WorkerKind, taken: Collection[int]) -> int:
    """The lowest address of this kind that nobody has; the cube grows when it is full."""
    address = KINDS.index(kind)
    while address in taken:
        address += len(KINDS)
    return address
