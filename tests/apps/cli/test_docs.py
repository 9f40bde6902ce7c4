"""rtc docs, and what an installed wheel has of the documentation and of the default programs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from rtc.apps.cli import docs
from rtc.programs.loader import default, merge
from rtc.protocol.messages import WorkerKind
from tests.apps.cli.in_process import call

ROOT = Path(__file__).parents[3]
PACKAGES = ("rtc", "broker", "workers", "sim_mcm", "deploy")


def test_a_list_and_a_page():
    listed = call("docs")
    assert listed.returncode == 0
    assert {"README", "tutorial", "scripts", "security"} <= {line.split()[0] for line in listed.stdout.splitlines()}
    assert call("docs", "tutorial").stdout == (ROOT / "docs" / "tutorial.md").read_text()
    assert call("docs", "docs/tutorial.md", "--path").stdout.strip() == str(ROOT / "docs" / "tutorial.md")


def test_an_unknown_page_is_refused_with_the_known_ones():
    done = call("docs", "tutorials")
    assert done.returncode == 2
    assert "tutorial," in done.stderr


def test_a_wheel_has_every_page_and_what_pages_show():
    """Paths in the wheel mirror those of the project, so that pages find each other and their pictures."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    top = "share/doc/telerobot-rtc"
    taken = {
        (place, path.relative_to(ROOT).as_posix())
        for place, globs in stated.items()
        for glob in globs
        for path in ROOT.glob(glob)
    }
    wanted = [path.relative_to(ROOT) for path in (ROOT / "docs").rglob("*") if path.is_file()]
    assert {(f"{top}/{path.parent.as_posix()}", path.as_posix()) for path in wanted} <= taken
    assert (top, "README.md") in taken
    assert f"{top}/docs/tutorial.md" == docs.INSTALLED


def test_messages_name_pages_by_a_command_that_prints_them():
    """A wheel has no directory docs/ beside the user."""
    texts = {path: path.read_text() for name in PACKAGES for path in (ROOT / name).rglob("*.py")}
    shown = {page for text in texts.values() for page in re.findall(r"rtc docs ([a-z][\w-]*)", text)}
    assert {"security", "scripts"} <= shown
    assert shown <= docs.pages().keys()
    helps = [path for path in texts if path.parent.name == "cli"]
    own = {path.name: re.sub(r'""".*?"""', "", texts[path], flags=re.DOTALL) for path in helps if path.stem != "docs"}
    assert [name for name, text in own.items() if re.search(r"docs/\w+\.md", text)] == []


def test_the_default_programs_are_exported_and_each_file_can_be_loaded(tmp_path: Path):
    target = tmp_path / "programs"
    assert call("load", "--export", str(target)).returncode == 0
    for kind in WorkerKind:
        files = [path for path in (target / kind.value).rglob("*") if path.is_file()]
        assert files
        for file in files:
            if kind is not WorkerKind.PARSER:
                assert merge(kind, default(kind), file.name, file.read_bytes()) == default(kind), file
    again = call("load", "--export", str(target))
    assert again.returncode == 2
    assert "exists already" in again.stderr


@pytest.mark.parametrize("extra", ["record", "observe"])
def test_missing_libraries_are_named_as_pip_wants_them(extra: str, monkeypatch: pytest.MonkeyPatch):
    from rtc.runtime import extras

    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"][extra]
    wanted = {re.split(r"[>=]", each)[0] for each in stated}
    assert set(extras.requirements(extra)) == wanted
    monkeypatch.setattr(extras, "_found", lambda module: False)
    purpose = next(name for name, by in extras.INSTALLED_BY.items() if by == extra)
    assert " -e " not in extras.missing(purpose)
    assert all(name in extras.missing(purpose) for name in wanted)
