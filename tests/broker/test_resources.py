"""All or nothing, in order, and nobody waits while holding."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from broker.resources import Blocked, Quarantine, Resources

ARM, OTHER, DB = {"ARM": True}, {"OTHER": True}, {"DB": False}


def test_an_exclusive_name_has_one_holder():
    r = Resources()
    assert r.take("C-1", ARM) == []
    assert r.take("C-2", ARM) == Blocked("ARM", "C-1")


def test_shared_names_have_many_holders_but_none_beside_an_exclusive_one():
    r = Resources()
    assert r.take("C-1", DB) == []
    assert r.take("C-2", DB) == []
    assert r.take("C-3", {"DB": True}) == Blocked("DB", "C-1")


def test_nothing_is_taken_when_not_all_can_be():
    r = Resources()
    r.take("C-1", ARM)
    assert r.take("C-2", {**OTHER, **ARM}) == Blocked("ARM", "C-1")
    assert r.take("C-3", OTHER) == []


def test_the_first_in_line_is_granted_and_later_ones_do_not_overtake_it():
    r = Resources()
    r.take("C-1", ARM)
    r.wait("C-2", {**ARM, **OTHER})
    assert r.take("C-3", OTHER) == Blocked("OTHER", "C-2")  # free, but C-2 was here first
    r.wait("C-3", OTHER)
    assert r.release("C-1") == ["C-2"]
    assert r.take("C-2", r.waiting["C-2"]) == []
    assert r.release("C-2") == ["C-3"]


def test_who_leaves_the_line_opens_it():
    r = Resources()
    r.take("C-1", ARM)
    r.wait("C-2", {**ARM, **OTHER})
    r.wait("C-3", OTHER)
    assert r.release("C-2") == ["C-3"]


def test_who_comes_back_to_the_line_stands_before_those_given_later():
    r = Resources()
    r.take("C-1", OTHER)
    r.take("C-2", ARM)
    r.wait("C-10", ARM)
    assert r.take("C-2", {**ARM, **OTHER}) == Blocked("OTHER", "C-1")
    assert r.wait("C-2", {**ARM, **OTHER}) == []  # it let go of the arm, and C-10 does not overtake it
    assert r.release("C-1") == ["C-2"]


def test_those_given_later_are_not_in_the_way_of_a_claim_that_grows():
    r = Resources()
    r.take("C-1", ARM)
    r.wait("C-2", {**ARM, **OTHER})
    assert r.take("C-1", {**ARM, **OTHER}) == []


def test_a_claim_may_grow_past_the_line_for_what_is_held_already():
    r = Resources()
    r.take("C-1", ARM)
    r.wait("C-2", ARM)
    assert r.take("C-1", {**ARM, **OTHER}) == []


def test_a_claim_that_shrinks_grants_what_it_lets_go():
    r = Resources()
    r.take("C-1", {**ARM, **OTHER})
    r.wait("C-2", OTHER)
    assert r.take("C-1", ARM) == ["C-2"]


def test_quarantine_keeps_a_name_closed_until_rest_is_confirmed():
    r = Resources()
    r.take("C-1", {**ARM, **OTHER})
    assert r.release("C-1", Quarantine("MCM", "C-1.1"), frozenset(ARM)) == []
    assert r.take("C-2", OTHER) == []
    assert r.take("C-3", ARM) == Blocked("ARM", "MCM, which has not confirmed rest")
    r.wait("C-3", ARM)
    assert r.confirm_rest("MCM") == ["C-3"]


claims = st.dictionaries(st.sampled_from("ABCD"), st.booleans(), min_size=1)


@given(st.lists(st.tuples(st.integers(0, 5), claims, st.booleans()), max_size=60))
def test_everybody_in_line_gets_their_turn_and_no_name_is_held_twice(acts):
    r = Resources()

    def grant(names):
        for name in names:
            if name in r.waiting:
                result = r.take(name, r.waiting[name])
                if isinstance(result, list):
                    grant(result)

    for n, claim, leave in acts:
        command = f"C-{n}"
        if leave:
            grant(r.release(command))
        elif command not in r.waiting:
            result = r.take(command, claim)
            grant(result if isinstance(result, list) else r.wait(command, claim))
        for holders in r.holders.values():
            assert len(holders) == 1 or not any(holders.values())
        assert not set(r.held) & set(r.waiting)
    while r.held or r.waiting:
        assert r.held, f"a deadlock: {r.waiting}"
        grant(r.release(next(iter(r.held))))
