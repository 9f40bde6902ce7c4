"""When a dead process is started again."""

from __future__ import annotations

import pytest

from deploy.restarts import Death, Policy, delay_s

POLICY = Policy(within_s=30.0, unready_deaths=4, deaths=6, first_delay_s=0.1, longest_delay_s=0.3)


def unready(*times):
    return [Death(t, was_ready=False) for t in times]


def ready(*times):
    return [Death(t, was_ready=True) for t in times]


@pytest.mark.parametrize(
    ("deaths", "delay"),
    [
        (ready(100), 0.0),  # a killed worker comes back at once
        (ready(100, 101, 102, 103, 104), 0.0),
        (ready(100, 101, 102, 103, 104, 105), None),  # too often in all
        (unready(100), 0.1),
        (unready(100, 101), 0.2),
        (unready(100, 101, 102), 0.3),  # 0.4, but no longer than the longest
        (unready(100, 101, 102, 103), None),  # it cannot start
        (unready(1, 2, 3, 100), 0.1),  # long ago is forgotten
        (ready(1, 2, 3, 4, 5, 100), 0.0),
        (unready(100) + ready(101), 0.0),
        (ready(100) + unready(101), 0.1),
    ],
)
def test_when_to_start_again(deaths, delay):
    assert delay_s(POLICY, deaths) == (None if delay is None else pytest.approx(delay))
