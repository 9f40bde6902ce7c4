"""The run directory while its cluster runs: deleted files, a lost lock, a directory that is gone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from deploy.cluster import _clean, _lock
from deploy.directory import TOUCH_S, Directory, claim_path
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.settings import LOCK


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    path.mkdir()
    (path / "settings.json").write_text("{}")
    return path


@pytest.fixture
def looked_after(run_dir: Path):
    with _lock(run_dir) as lock:
        yield Directory(run_dir, lock, {"settings.json": lambda: (run_dir / "settings.json").write_text("{}")})


def test_a_whole_directory_is_left_alone(looked_after: Directory) -> None:
    assert looked_after.look(1.0) == ([], "")


def test_a_deleted_file_is_written_again(run_dir: Path, looked_after: Directory) -> None:
    (run_dir / "settings.json").unlink()
    assert looked_after.look(1.0) == (["settings.json"], "")
    assert (run_dir / "settings.json").exists()


def test_a_deleted_lock_is_held_again(run_dir: Path, looked_after: Directory) -> None:
    (run_dir / LOCK).unlink()
    assert looked_after.look(1.0) == ([], "")
    with pytest.raises(ClusterError, match="already running"), _lock(run_dir):
        pass


def test_a_lock_that_another_holds_ends_the_cluster(run_dir: Path, looked_after: Directory) -> None:
    (run_dir / LOCK).unlink()
    with _lock(run_dir):
        assert looked_after.look(1.0) == ([], f"another supervisor holds {run_dir / LOCK}")
        assert not looked_after.ours()


@pytest.mark.parametrize("again", [False, True], ids=["renamed", "and made anew"])
def test_a_directory_that_is_gone_ends_the_cluster(run_dir: Path, looked_after: Directory, again: bool) -> None:
    run_dir.rename(run_dir.with_name("elsewhere"))
    if again:
        run_dir.mkdir()
    assert looked_after.look(1.0) == ([], f"{run_dir} was renamed or removed")
    assert not looked_after.ours()


def test_everything_is_touched_before_a_cleaner_comes(run_dir: Path, looked_after: Directory) -> None:
    looked_after.look(1.0)
    os.utime(run_dir / "settings.json", (0, 0))
    looked_after.look(2.0)
    assert (run_dir / "settings.json").stat().st_atime == 0
    looked_after.look(2.0 + TOUCH_S)
    assert (run_dir / "settings.json").stat().st_atime > 0
    assert (run_dir / "settings.json").stat().st_mtime == 0


def test_a_path_has_one_supervisor_although_its_directory_is_another(run_dir: Path) -> None:
    claim = claim_path(run_dir)
    run_dir.rename(run_dir.with_name("elsewhere"))
    run_dir.mkdir()
    with pytest.raises(ClusterError, match="still runs, although its directory was renamed or removed"):
        claim_path(run_dir)
    claim.close()
    claim_path(run_dir).close()


def test_the_journals_of_the_last_three_runs_are_kept(run_dir: Path) -> None:
    for run in "abcde":
        _clean(run_dir)
        (run_dir / "journal.db").write_text(run)
        (run_dir / "ended.txt").write_text(run)
        (run_dir / "journal.db.damaged-20260101-000000").write_text(run)
    _clean(run_dir)
    kept = {path.parent.name: path.read_text() for path in run_dir.glob("previous*/journal.db")}
    assert kept == {"previous": "e", "previous-2": "d", "previous-3": "c"}
    assert (run_dir / "previous" / "ended.txt").read_text() == "e"
    assert not (run_dir / "ended.txt").exists()
    assert not list(run_dir.glob("*.db*"))
