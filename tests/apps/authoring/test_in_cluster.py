"""An arm that the project does not know, in a real cluster: sentences move it, and a key shows its scene.

Exact; in physics the same sentences are typed from `docs/own-arm.md`, and run in `test_unknown_arms`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyRing
from tests.apps.cli.in_process import call
from tests.processes.test_gateway import free_ports

pytestmark = [pytest.mark.slow, pytest.mark.untimed]
LIMIT_S = 60.0


def test_sentences_move_it_and_a_key_shows_it(first_cell: Callable[[str], Path], tmp_path: Path) -> None:
    file, key, picture = first_cell("PANDA"), tmp_path / "observer.key", tmp_path / "far.png"
    listen = f"tcp://127.0.0.1:{free_ports()}"
    with own_cluster(cell=str(file), mcm="kinematic", speed="max", listen=listen) as run_dir, Client(run_dir) as rtc:
        for sentence in ("GRASP CUBE WITH ARM PANDA", "LIFT CUBE BY 10 CM", "STOW ARM PANDA"):
            outcome = rtc.run(sentence, timeout_s=LIMIT_S).outcome
            assert outcome.kind is OutcomeKind.SUCCEEDED, (sentence, outcome)
        KeyRing(run_dir).new("observer", Role.OBSERVER, listen, key)
        with Client(key=key) as far:
            assert Cell.from_bytes(far.cell()).digest() == Cell.load(file).digest()
        done = call("look", "--with", str(key), "-o", str(picture), "--json")
        assert done.returncode == 0, done.stderr
        (arm,) = json.loads(done.stdout)["arms"]
        assert (arm["name"], arm["holding"]) == ("PANDA", "CUBE")
        assert picture.read_bytes().startswith(b"\x89PNG")
