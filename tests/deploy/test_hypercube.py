"""Addresses in the cube and the kinds of worker at them."""

from __future__ import annotations

import pytest

from deploy.hypercube import addresses, kind_of, name_of, next_free, replicas
from rtc.protocol.messages import WorkerKind


def test_the_names_of_the_smallest_cube():
    assert [name_of(a) for a in addresses(2)] == ["parser@0", "elaborator@1", "binder@2", "analyzer@3"]


@pytest.mark.parametrize("dim", [1, 9, -1])
def test_a_cube_needs_all_four_kinds_and_an_end(dim):
    with pytest.raises(ValueError, match="dimension is 2 to 8"):
        addresses(dim)


@pytest.mark.parametrize("kind", WorkerKind)
def test_replicas_are_the_lowest_addresses_of_their_kind(kind):
    assert replicas(kind, 3) == [a for a in range(12) if kind_of(a) == kind]


def test_a_new_node_takes_the_lowest_free_address_of_its_kind():
    assert next_free(WorkerKind.BINDER, addresses(2)) == 6
    assert next_free(WorkerKind.BINDER, {0, 1, 3, 6}) == 2
    assert next_free(WorkerKind.PARSER, ()) == 0
