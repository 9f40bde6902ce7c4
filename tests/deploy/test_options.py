"""The settings of `up`, checked before anything is started."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from deploy import cluster
from deploy.__main__ import INVALID_OPTION, main
from rtc.runtime.settings import Settings

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"least_workers": 5, "most_workers": 2}, "--least 5 is more than --most 2"),
        ({"least_workers": 5}, "--least 5 is more than --most 4"),
        ({"cell": "moon-base"}, "no cell moon-base"),
        ({"cell": "moon-base.yaml"}, "there is no file moon-base.yaml"),
        ({"cell": str(README)}, "README.md is not a cell: a cell is a .yaml file"),
        ({"listen": "foo"}, "'foo' is not an address"),
        ({"dim": 9}, "$.dim"),
        ({"most_workers": 0}, "$.most_workers"),
        ({"mcm": "steam"}, "$.mcm"),
        ({"speed": -1}, "$.speed"),
    ],
)
def test_a_wrong_option_is_reported_before_anything_is_started(
    settings: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "none"
    assert main(["up", "-d", json.dumps({"run_dir": str(run_dir), **settings})]) == INVALID_OPTION
    assert words in capsys.readouterr().err
    assert not run_dir.exists()


@pytest.mark.parametrize(("dim", "most"), [(2, 1), (2, 4), (4, 4), (3, 1)])
def test_a_further_worker_never_gets_an_address_of_other_machines(dim: int, most: int) -> None:
    settings = Settings(run_dir="/nowhere", dim=dim, most_workers=most)
    last = settings.first_remote_node - 1

    assert cluster.new_worker(settings, last, -1) == cluster.worker(settings, last)
    assert cluster.new_worker(settings, last + 1, -1) is None
