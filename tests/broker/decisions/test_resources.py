"""All or nothing, in order, and no command waits while it holds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from broker.decisions.resources import Blocked, Claim, Quarantine, Resources, number

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


def test_who_leaves_the_middle_of_a_line_lets_those_behind_it_share():
    r = Resources()
    r.take("C-1", DB)
    r.wait("C-2", {"DB": True})
    r.wait("C-3", {**DB, **ARM})
    r.wait("C-4", {"DB": True})
    r.wait("C-5", DB)
    assert r.release("C-2") == ["C-3"]
    assert r.take("C-3", r.waiting["C-3"]) == []
    assert r.release("C-4") == ["C-5"]


def test_of_thousands_who_share_a_name_the_end_of_one_asks_once_who_is_next():
    r = Resources()
    r.take("C-1", {"OBJECT": True, "ARM": True})
    for n in range(2, 2001):
        r.wait(f"C-{n}", {"OBJECT": False, "ARM": True})
    asked = []
    first, Resources.blocker = Resources.blocker, lambda *asks: asked.append(asks[1]) or first(*asks)
    try:
        assert r.release("C-1") == ["C-2"]
        assert r.release("C-2") == ["C-3"]  # one that never had its turn
    finally:
        Resources.blocker = first
    assert set(asked) <= {"C-2", "C-3"}


claims = st.dictionaries(st.sampled_from("ABCD"), st.booleans(), min_size=1)
acts_of_many = st.tuples(st.integers(0, 7), claims, st.sampled_from(["claim", "claim", "end", "end in doubt", "rest"]))


@given(st.lists(acts_of_many, max_size=60))
def test_everybody_in_line_gets_their_turn_and_no_name_is_held_twice(acts):
    r = Resources()

    def grant(names):
        for name in names:
            if name in r.waiting:
                result = r.take(name, r.waiting[name])
                if isinstance(result, list):
                    grant(result)

    for n, claim, act in acts:
        command = f"C-{n}"
        if act == "rest":
            grant(r.confirm_rest("MCM", set(claim)))
        elif act == "end in doubt":
            grant(r.release(command, Quarantine("MCM", f"{command}.1"), frozenset(claim)))
        elif act == "end":
            grant(r.release(command))
        elif command not in r.waiting:
            result = r.take(command, claim)
            grant(result if isinstance(result, list) else r.wait(command, claim))
        for holders in r.holders.values():
            assert len(holders) == 1 or not any(holders.values())
        assert not set(r.held) & set(r.waiting)
        for waiting, wanted in r.waiting.items():
            assert in_the_way(r, waiting, wanted), f"{waiting} waits for nothing"
            assert r.blocker(waiting, wanted) is not None
    grant(r.confirm_rest("MCM"))
    while r.held or r.waiting:
        assert r.held, f"a deadlock: {r.waiting}"
        grant(r.release(next(iter(r.held))))
    assert not r.lines
    assert not r.alone


def in_the_way(r: Resources, command: str, claim: Claim) -> list[str]:
    """By looking at everybody: who holds or wants earlier what one of the two wants alone."""
    found = [name for name in claim if name in r.quarantine]
    for name, exclusive in claim.items():
        for other, theirs in [*r.held.items(), *((w, c) for w, c in r.waiting.items() if number(w) < number(command))]:
            if other != command and name in theirs and (exclusive or theirs[name]):
                found.append(other)
    return found
