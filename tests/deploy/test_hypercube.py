"""Addresses, neighbours, halves and ways in the cube."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.hypercube import address_of, addresses, half_cubes, kind_of, name_of, neighbours, next_free, route
from rtc.messages import WorkerKind

NODE = st.integers(0, 255)


def test_the_names_of_the_smallest_cube():
    assert [name_of(a) for a in addresses(2)] == ["parser@0", "elaborator@1", "binder@2", "analyzer@3"]


@given(NODE)
def test_a_name_leads_back_to_its_address(address):
    assert address_of(name_of(address)) == address


@pytest.mark.parametrize("name", ["binder@3", "binder@x", "MCM", "binder@02"])
def test_a_name_that_no_node_bears(name):
    with pytest.raises(ValueError, match=r"no node|invalid literal"):
        address_of(name)


@pytest.mark.parametrize("dim", [1, 9, -1])
def test_a_cube_needs_all_four_kinds_and_an_end(dim):
    with pytest.raises(ValueError, match="dimension is 2 to 8"):
        addresses(dim)


def test_neighbours_differ_in_one_bit():
    assert neighbours(0b101, 3) == [0b100, 0b111, 0b001]


@pytest.mark.parametrize("dim", range(3, 9))
def test_each_half_has_every_kind_equally_often(dim):
    live, test = half_cubes(dim)
    assert sorted(live + test) == list(addresses(dim))
    for half in (live, test):
        assert {kind: sum(kind_of(a) == kind for a in half) for kind in WorkerKind} == dict.fromkeys(
            WorkerKind, 2 ** (dim - 3)
        )


def test_a_cube_without_halves_serves_both():
    assert half_cubes(2) == ([0, 1, 2, 3], [0, 1, 2, 3])


@given(NODE, NODE)
def test_a_way_is_shortest_and_goes_from_neighbour_to_neighbour(start, end):
    way = route(start, end)
    assert (way[0], way[-1], len(way)) == (start, end, (start ^ end).bit_count() + 1)
    assert all((a ^ b).bit_count() == 1 for a, b in itertools.pairwise(way))


@given(NODE, NODE)
def test_dimensions_rise_along_a_way(start, end):
    way = route(start, end)
    steps = [a ^ b for a, b in itertools.pairwise(way)]
    assert steps == sorted(steps)


def test_a_new_node_takes_the_lowest_free_address_of_its_kind():
    assert next_free(WorkerKind.BINDER, addresses(2)) == 6
    assert next_free(WorkerKind.BINDER, {0, 1, 3, 6}) == 2
    assert next_free(WorkerKind.PARSER, ()) == 0
