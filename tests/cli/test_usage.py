"""What a user gets wrong is said in one sentence, at once, with exit status 2."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from rtc.cli.main import main


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("demo grasp --speed abc", "--speed is a number above 0, or max; not abc"),
        ("demo grasp --speed 0", "--speed is a number above 0, or max; not 0"),
        ("up --speed inf", "--speed is a number above 0, or max; not inf"),
        ("keys revoke nix --run-dir DIR", "there is no key 'nix'"),
        ("status --with DIR/nix", "there is no key file"),
        ("world watch --every inf", "less than or equal to"),
        ("world watch --every nan", "less than or equal to"),
        (f"chaos --for {'9' * 400}s", "--for is a duration"),
    ],
)
def test_a_wrong_word_is_2_in_a_sentence(
    words: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["rtc", *words.replace("DIR", str(tmp_path)).split()])
    for name in ("stdin", "stdout", "stderr"):  # put back afterwards: `main` attaches its own
        monkeypatch.setattr(sys, name, getattr(sys, name))
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert said in " ".join(capsys.readouterr().err.split())
