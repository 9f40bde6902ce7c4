"""When a dead process is started again."""

from __future__ import annotations

import pytest

from deploy.restarts import Death, Policy, delay_s

POLICY = Policy(within_s=30.0, short_s=1.0, spared=2, first_delay_s=0.1, longest_delay_s=0.3, unready_deaths=4)


def unready(*times):
    return [Death(t, was_ready=False) for t in times]


def short(*times):
    return [Death(t, was_ready=True, lived_s=0.2) for t in times]


def worked(*times):
    return [Death(t, was_ready=True, lived_s=1.5) for t in times]


@pytest.mark.parametrize(
    ("deaths", "delay"),
    [
        (worked(100), 0.0),  # a killed worker comes back at once
        (worked(*range(100, 200)), 0.0),  # however often
        (short(100, 100.3), 0.0),  # a job may have killed it
        (short(100, 100.3, 100.6), 0.1),  # a crash loop
        (short(100, 100.3, 100.6, 101), 0.2),
        (short(*range(100, 200)), 0.3),  # 0.4 and more, but no longer than the longest, and never given up
        (short(1, 2, 3, 100), 0.0),  # long ago is forgotten
        (short(100, 101, 102) + worked(104), 0.0),  # the trouble is over
        (unready(100), 0.1),
        (unready(100, 101), 0.2),
        (unready(100, 101, 102), 0.3),
        (unready(100, 101, 102, 103), None),  # it cannot start
        (unready(1, 2, 50, 100), None),  # however slowly
        (unready(100, 101, 102) + short(103) + unready(104), 0.3),  # it can
        (worked(90) + unready(*range(100, 200)), 0.3),  # it could, before the disk was full
        (worked(100) + unready(101), 0.1),
    ],
)
def test_when_to_start_again(deaths, delay):
    was_ready = any(death.was_ready for death in deaths)
    assert delay_s(POLICY, deaths, was_ready) == (None if delay is None else pytest.approx(delay))
