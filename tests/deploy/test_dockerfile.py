"""deploy/Dockerfile, instruction by instruction. No image is built."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
import typer

from rtc.apps.cli.main import build
from rtc.runtime.settings import default_run_dir
from tests.test_documentation import parse_options

ROOT = Path(__file__).parents[2]
FILE = ROOT / "deploy" / "Dockerfile"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
KNOWN = {"FROM", "WORKDIR", "COPY", "RUN", "USER", "ENV", "ENTRYPOINT", "CMD"}


def instructions() -> list[tuple[str, str]]:
    """(word, rest) of each instruction, in order; without comments."""
    lines = [line for line in FILE.read_text().splitlines() if line and not line.startswith("#")]
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines)]


def all_of(word: str) -> list[str]:
    return [rest for each, rest in instructions() if each == word]


def copied() -> list[str]:
    return [source for rest in all_of("COPY") for source in rest.split()[:-1]]


def test_it_has_known_instructions_and_an_official_base_image():
    assert {word for word, _ in instructions()} <= KNOWN
    (image,) = all_of("FROM")
    assert re.fullmatch(r"python:3\.\d+-slim", image)
    assert f">={image[7:11]}" == PROJECT["project"]["requires-python"]


@pytest.mark.parametrize("source", copied())
def test_a_copied_source_exists_and_is_not_ignored(source: str):
    assert (ROOT / source).exists()
    ignored = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line]
    assert not [glob for glob in ignored if fnmatch(source, glob.removeprefix("**/"))]


def test_all_that_a_wheel_is_made_of_is_copied():
    setuptools = PROJECT["tool"]["setuptools"]
    packages = [name.removesuffix("*") for name in setuptools["packages"]["find"]["include"]]
    files = [glob.partition("/")[0] for globs in setuptools["data-files"].values() for glob in globs]
    assert {*packages, *files, "pyproject.toml", "LICENSE", PROJECT["project"]["readme"]} <= set(copied())


def test_what_is_run_exists():
    _, installs, adds_user = (shlex.split(line) for line in all_of("RUN"))
    assert installs[:2] == ["pip", "install"]
    assert installs[installs.index("-c") + 1] in copied()
    assert [option for option in installs if option.startswith("-")] == ["--no-cache-dir", "-c"]
    wanted = re.fullmatch(r"\.\[([\w,]+)\]", installs[-1])
    assert wanted
    assert set(wanted[1].split(",")) <= PROJECT["project"]["optional-dependencies"].keys()
    assert adds_user[0] == "useradd"
    assert all_of("USER") == [adds_user[-1]]  # not root


def test_it_starts_a_command_of_rtc(monkeypatch: pytest.MonkeyPatch):
    (entry,), (command,) = ([json.loads(rest) for rest in all_of(word)] for word in ("ENTRYPOINT", "CMD"))
    assert set(entry) <= PROJECT["project"]["scripts"].keys()
    check(command)
    (variable,) = all_of("ENV")
    name, _, value = variable.partition("=")
    monkeypatch.setenv(name, value)
    assert str(default_run_dir()) == value


def test_the_commands_of_its_comment_are_valid():
    lines = re.findall(r"^#   docker (.*)$", FILE.read_text(), re.MULTILINE)
    built = next(shlex.split(line) for line in lines if line.startswith("build"))
    assert (ROOT / built[built.index("-f") + 1]).samefile(FILE)
    executed = [shlex.split(line)[2:] for line in lines if line.startswith("exec")]
    assert executed
    for words in executed:
        assert words[0] == "rtc"
        check(words[1:])


def check(words: list[Any]) -> None:
    parse_options(typer.main.get_command(build([words[0]])), list(words))
