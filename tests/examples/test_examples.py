"""Each program of examples/ runs as it stands, against one cluster in physics."""

from __future__ import annotations

import os
import runpy
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

EXAMPLES = Path(__file__).parents[2] / "examples"
PRINTED = {  # what each prints at its end
    "operator_script.py": "both have moved the arm",  # first: a wrist held as it is does not allow every path
    "pick_and_place.py": "STOW RIGHT-ARM",
    "guarded_probe.py": "contact with",
    "two_arms.py": "at most 2 commands",
    "planner_loop.py": "succeeded: STOW RIGHT-ARM",
    "plugin/use_it.py": "the hand holds at",
}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Its environment has the package of examples/plugin, as an installation would leave it."""
    site = tmp_path_factory.mktemp("site")
    plugin = tomllib.loads((EXAMPLES / "plugin/pyproject.toml").read_text())
    info = site / "hand_report-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: hand-report\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "".join(
            f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in entries.items())
            for group, entries in plugin["project"]["entry-points"].items()
        )
    )
    with pytest.MonkeyPatch.context() as patch:
        path = [str(site), str(EXAMPLES / "plugin"), os.environ.get("PYTHONPATH", "")]
        patch.setenv("PYTHONPATH", os.pathsep.join(path))
        with own_cluster(speed="max", dim=2) as run_dir:
            patch.setenv("RTC_RUN_DIR", str(run_dir))
            yield run_dir


def test_all_programs_are_tried() -> None:
    files = {str(path.relative_to(EXAMPLES)) for path in EXAMPLES.rglob("*.py") if "def main" in path.read_text()}
    own = {name for name in files if name.startswith("swapout/")}  # `test_swapout` performs it, on its own cluster
    assert files - own == set(PRINTED)


@pytest.mark.parametrize("name", PRINTED)
def test_the_program_runs(name: str, cluster: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert PRINTED[name] in capsys.readouterr().out
