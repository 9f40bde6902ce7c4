"""Recoveries that are searched or follow rules, on toy graphs; and the table of outcomes with every trimmer."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtc.programs import loader
from rtc.programs.compatibility import misfits
from rtc.programs.outcome_table import outcomes, rows_of
from rtc.programs.recovery import searched
from rtc.programs.schema import AnalyzerProgram, BinderProgram, ElaboratorProgram, SearchModel
from rtc.programs.splice import spliced
from rtc.protocol.messages import TrimOffer
from rtc.protocol.outcomes import OF_OPERATOR, ProgramError, StopReason

TOY = """{"most": 3, "breaks": {"contact": ["clear", "located"], "slip": ["firm"], "timeout": ["awake"]}, "pieces": {
  "back": {"makes": ["clear"], "breaks": ["firm"]}, "look": {"needs": ["clear"], "makes": ["located"]},
  "grip": {"needs": ["located"], "makes": ["firm"]}, "wait": {"makes": ["awake"], "breaks": ["firm"]}}}"""
RESERVE = "reserve: [{skill: look-where-it-stands}, {skill: vision}, {skill: relocate}, {skill: regrasp}]"
RULES = """
trimmers: [rules]
rules:
  - {classes: [touched_object], when: [{of: force_n, at_least: 20}], trim: relocate}
  - {reasons: [slip], trim: regrasp}
  - {trim: vision}
"""


def found(reason: StopReason, **entries: str) -> list[int]:
    model = msgspec.json.decode(TOY, type=SearchModel)
    offers = {int(n[1:]): TrimOffer(skill=skill) for n, skill in entries.items()}
    return searched(model, reason, offers)


@pytest.mark.parametrize(
    ("reason", "entries", "expected"),
    [
        (StopReason.SLIP, {"n1": "grip"}, [1]),
        (StopReason.CONTACT, {"n1": "look", "n2": "grip", "n3": "back"}, [3, 1, 2]),  # nothing else reaches the goal
        (StopReason.CONTACT, {"n1": "look", "n3": "back"}, []),  # would leave the grip open
        (StopReason.TIMEOUT, {"n4": "wait", "n2": "grip"}, [4, 2]),
        (StopReason.SLIP, {"n1": "unknown"}, []),
        (StopReason.HALT, {"n1": "grip"}, []),  # an event without a row
    ],
)
def test_the_search_finds_the_shortest_recovery_of_a_toy_graph(reason, entries, expected):
    assert found(reason, **entries) == expected


def test_an_entry_that_gives_up_is_no_recovery():
    model = msgspec.json.decode(TOY, type=SearchModel)
    assert searched(model, StopReason.SLIP, {1: TrimOffer(skill="grip", then="give_up")}) == []


@given(
    st.dictionaries(st.sampled_from(list(StopReason)), st.sets(st.sampled_from("abcd")), max_size=4),
    st.lists(st.tuples(*[st.sets(st.sampled_from("abcd"))] * 3), min_size=1, max_size=6),
)
def test_a_recovery_leads_to_a_world_without_broken_conditions(breaks, pieces):
    """Whatever the tables are, the search ends, within `most` pieces, and its answer is executable."""
    made = {str(n): dict(zip(("needs", "makes", "breaks"), map(list, p), strict=True)) for n, p in enumerate(pieces)}
    document = {"most": 4, "breaks": {reason.value: list(broken) for reason, broken in breaks.items()}, "pieces": made}
    model = msgspec.convert(document, SearchModel)
    for reason, broken in breaks.items():
        entries = searched(model, reason, {n: TrimOffer(skill=name) for n, name in enumerate(made)})
        assert len(entries) <= 4
        state = set(broken)
        for n in entries:
            assert not state & set(made[str(n)]["needs"])
            state = state - set(made[str(n)]["makes"]) | set(made[str(n)]["breaks"])
        assert not (entries and state)


@pytest.mark.parametrize("text", ["trimmers: [stack]", "trimmers: [stack, search]", "trimmers: [search]", RULES])
def test_no_cell_of_any_script_is_empty_with_any_trimmer(text):
    """Also of its trims; a step without motion has one row."""
    elaborator = loader.merge("elaborator", loader.default("elaborator"), "reserve.yaml", RESERVE.encode())
    analyzer = loader.merge("analyzer", loader.default("analyzer"), "trimmers.yaml", text.encode())
    whole = spliced(loader.decode(elaborator, ElaboratorProgram))
    others = loader.decode(loader.default("binder"), BinderProgram), loader.decode(analyzer, AnalyzerProgram)
    assert not list(misfits(whole, *others))
    tables = {script.script: list(rows_of(script, whole, *others)) for script in whole.scripts}
    for name, rows in tables.items():
        assert all(row.response for row in rows), name
        steps: dict[str, set[StopReason]] = {}
        for row in rows:
            steps.setdefault(row.step, set()).add(row.reason)
        assert all(reasons | OF_OPERATOR == set(StopReason) for reasons in steps.values() if len(reasons) > 1), name
    assert len(tables) > 50


def test_the_table_shows_what_a_search_would_do():
    elaborator = loader.merge("elaborator", loader.default("elaborator"), "reserve.yaml", RESERVE.encode())
    analyzer = loader.merge("analyzer", loader.default("analyzer"), "trimmers.yaml", b"trimmers: [stack, search]")
    rows = outcomes(elaborator, loader.default("binder"), analyzer, "grasp-centering")
    first = next(row for row in rows if row.step.startswith("3 ") and row.reason is StopReason.REFUSED)
    assert first.response.startswith("trim 1001 (look-where-it-stands)")


@pytest.mark.parametrize(
    "text",
    [
        "trimmers: [expert]",
        "trimmers: []",
        "trimmers: [rules]",
        "rules: [{trim: no-such-piece}]",
        "rules: [{classes: [wrong], trim: vision}]",
        "rules: [{when: [{of: wind}], trim: vision}]",
        "search: {breaks: {slip: [firm]}, pieces: {}}",
        "search: {breaks: {}, pieces: {no-such-piece: {makes: [firm]}}}",
        "search: {most: 9, breaks: {}, pieces: {}}",
    ],
)
def test_a_trimmer_without_effect_is_refused_when_it_is_loaded(text):
    others = {kind: loader.default(kind) for kind in ("elaborator", "binder")}
    with pytest.raises(ProgramError):
        loader.merge("analyzer", loader.default("analyzer"), "t.yaml", text.encode(), others)
