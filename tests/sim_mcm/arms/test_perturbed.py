"""RTC_PHYSICS_SEED: simulations differ a little from their cell files, so that no test hangs on a hair."""

from __future__ import annotations

import pybullet
import pytest

from sim_mcm.arms.bullet_arm import PERTURBED, BulletCell


def _of(cell, monkeypatch, seed: str) -> list[float]:
    """Masses and friction of all movable objects, and friction of all pads."""
    monkeypatch.setenv("RTC_PHYSICS_SEED", seed)
    sim = BulletCell(cell)
    try:
        client = sim.world.client
        bodies = [sim.world.objects[name].id for name in sorted(sim.world.movable)]
        found = [part for body in bodies for part in pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[:2]]
        pads = [(arm.body, finger) for arm in sim.arms.values() for finger in arm.fingers]
        return found + [pybullet.getDynamicsInfo(*pad, physicsClientId=client)[1] for pad in pads]
    finally:
        sim.close()


@pytest.mark.physics
def test_masses_and_friction_are_drawn_from_the_seed_and_differ_little(cell, monkeypatch):
    exact, first, again, other = (_of(cell, monkeypatch, seed) for seed in ("", "1", "1", "2"))
    assert first == again
    assert all(a != b for a, b in zip(first, other, strict=True))
    for file, drawn in zip(exact, first, strict=True):
        assert drawn != file
        assert drawn == pytest.approx(file, rel=1.001 * PERTURBED)
