"""What `rtc status` makes of a broker's answer: few rows, names that people know."""

from __future__ import annotations

from typing import Any

from rtc.apps.cli.cluster import folded, programs_in_words


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
