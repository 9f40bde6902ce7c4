"""The file of a benchmark's results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.report import finish


@pytest.mark.parametrize("data", [None, {"a": [1, 2]}, [], [{"number": 1, "off": [0.5]}, {"number": 2, "off": []}]])
def test_results_are_read_as_they_were_written(tmp_path: Path, data: Any) -> None:
    finish("one", {"runs": 2.0}, [("runs", "2")], tmp_path, data)
    text = (tmp_path / "one.json").read_text()
    document = json.loads(text)
    assert document.get("data") == data
    assert document["metrics"] == {"runs": 2.0}
    if isinstance(data, list):  # a run is one line, so that a changed run is one changed line
        assert {json.dumps(row) for row in data} <= {line.strip(" ,") for line in text.splitlines()}
