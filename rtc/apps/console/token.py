"""The token of a run: a gateway that is started again in the same run uses the same one, so that pages come back."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

import msgspec

FILE = "console.token"  # in the run directory, 0600


class Token(msgspec.Struct, frozen=True):
    run: str
    token: str


def of_run(run_dir: Path | None, run: str) -> str:
    """The token of this run, from the run directory; a new one there if it is of another run. Raises OSError.

    `run_dir` is None for a cluster on another machine: the token is then that of this gateway alone."""
    if run_dir is None:
        return secrets.token_urlsafe(32)
    path = run_dir / FILE
    with contextlib.suppress(OSError, msgspec.MsgspecError):
        kept = msgspec.json.decode(path.read_bytes(), type=Token)
        if kept.run == run:
            return kept.token
    made = Token(run, secrets.token_urlsafe(32))
    draft = run_dir / f"{FILE}.{os.getpid()}"
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(msgspec.json.encode(made))
    draft.rename(path)
    return made.token
