"""What a worker's function refuses, as a value."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rtc.protocol.outcomes import Refusal, Refused


def refusal_of(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Refusal:
    """The refusal that this call raises; the test fails if it raises none."""
    with pytest.raises(Refused) as caught:
        function(*args, **kwargs)
    return caught.value.refusal
