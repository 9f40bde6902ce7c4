"""The file of settings."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rtc.runtime.settings import SETTINGS, Settings


def test_a_reader_sees_whole_settings_while_they_are_written_anew(tmp_path: Path) -> None:
    Settings(run_dir=str(tmp_path), cell="swapout").save()
    with (tmp_path / SETTINGS).open("rb") as reader:
        Settings(run_dir=str(tmp_path), cell="servicing").save()
        assert msgspec.json.decode(reader.read(), type=Settings).cell == "swapout"
    assert Settings.load(tmp_path).cell == "servicing"
