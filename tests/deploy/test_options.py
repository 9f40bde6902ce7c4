"""The options of `up`, checked before anything is started."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.__main__ import WRONG, main

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--least", "5", "--most", "2"], "--least 5 is more than --most 2"),
        (["--least", "5"], "--least 5 is more than --most 4"),
        (["--cell", "moon-base"], "no cell moon-base"),
        (["--cell", "moon-base.yaml"], "there is no file moon-base.yaml"),
        (["--cell", str(README)], "README.md is not a cell: a cell is a .yaml file"),
        (["--listen", "foo"], "'foo' is not an address"),
    ],
)
def test_a_wrong_option_is_reported_before_anything_is_started(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "none"
    assert main(["up", "-d", *options, "--run-dir", str(run_dir)]) == WRONG
    assert words in capsys.readouterr().err
    assert not run_dir.exists()


@pytest.mark.parametrize("speed", ["inf", "nan", "-1", "fast"])
def test_a_speed_that_is_none_is_refused(speed: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["up", "--speed", speed])
    assert left.value.code == WRONG
