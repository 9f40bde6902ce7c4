"""Ways between two nodes of the cube: a direct link, or dimension-order routing through intermediate nodes. Pure."""

from __future__ import annotations

from collections.abc import Iterator


def hops(source: int, target: int) -> int:
    """Number of links between two nodes: the bits in which their addresses differ."""
    return (source ^ target).bit_count()


def between(source: int, target: int) -> Iterator[int]:
    """The intermediate nodes of dimension-order routing: the lowest differing bit is corrected first."""
    node, differing = source, source ^ target
    while differing:
        lowest = differing & -differing
        node ^= lowest
        differing ^= lowest
        if differing:
            yield node


def homes(brokers: int, dim: int) -> list[int]:
    """Nodes at which the brokers are attached, evenly spaced. Raises ValueError if there are more than nodes."""
    if not 1 <= brokers <= 1 << dim:
        raise ValueError(f"{brokers} brokers need 1 to {1 << dim} nodes")
    return [(n << dim) // brokers for n in range(brokers)]
