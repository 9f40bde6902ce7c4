"""What `rtc status` makes of a broker's answer: few rows, names that people know."""

from __future__ import annotations

from typing import Any

from rtc.apps.cli.status import collision_checks_in_words, folded, programs_in_words


def row(name: str, state: str = "ready", restarts: int = 0) -> dict[str, Any]:
    return {"name": name, "state": state, "restarts": restarts, "pid": 7}


def test_templates_are_one_row_and_those_in_trouble_their_own() -> None:
    rows = [row("template"), row("broker"), row("broker-template", restarts=2), row("MCM-template", "looping")]
    names = {one["name"]: one for one in folded(rows)}

    assert list(names) == ["broker", "MCM-template", "2 templates"]
    assert names["2 templates"]["restarts"] == 2
    assert "pid" not in names["2 templates"]


def test_programs_are_named_by_file_and_age() -> None:
    loaded = {"elaborator": {"file": "my_lift.yaml", "age_s": 185.0}}

    assert programs_in_words({"program_files": loaded}) == (
        "elaborator my_lift.yaml (loaded 3 min ago), the others: default programs"
    )
    assert programs_in_words({}) == "all as they come with rtc"


def test_collision_checks_are_those_of_the_workers_that_plan_and_slower_ones_are_named() -> None:
    parser = {"name": "parser@0", "kind": "parser", "abilities": []}
    quick = {"name": "binder@2", "kind": "binder", "abilities": ["boxes"]}
    slow = {"name": "elaborator@1", "kind": "elaborator", "abilities": []}

    assert collision_checks_in_words({"workers": [parser]}) == ""
    assert "coal alone" not in collision_checks_in_words({"workers": [parser, quick]})
    assert "elaborator@1" in collision_checks_in_words({"workers": [quick, slow]})
    assert "coal alone" in collision_checks_in_words({"workers": [slow]})
