"""The token of a run: the same after a restart of the gateway, another one in another run, readable by its owner."""

from __future__ import annotations

from rtc.apps.console import token


def test_a_gateway_that_starts_again_has_the_token_of_the_run(tmp_path):
    first = token.of_run(tmp_path, "run-1")
    assert token.of_run(tmp_path, "run-1") == first
    assert token.of_run(tmp_path, "run-2") != first
    assert (tmp_path / token.FILE).stat().st_mode & 0o777 == 0o600


def test_a_damaged_file_is_replaced(tmp_path):
    (tmp_path / token.FILE).write_text("{")
    assert len(token.of_run(tmp_path, "run-1")) > 40


def test_without_a_run_directory_each_gateway_has_its_own():
    assert token.of_run(None, "") != token.of_run(None, "")
