"""Which cameras see a body: what is kept from job to job changes no answer."""

from __future__ import annotations

import numpy as np

from rtc.spatial import geometry
from workers.planning.sight import Sight, bodies


def test_what_was_seen_before_changes_no_answer(cell, arms):
    kept, random = Sight(cell), np.random.default_rng(3)
    answers = set()
    for n in range(40):
        postures = {name: np.array((0.0, 0.8, -1.6, 0.0, 0.5, 0.0)) + random.uniform(-0.5, 0.5, 6) for name in arms}
        poses = {name: arms[name].fk(q) for name, q in postures.items()}
        body = bodies(cell)[n % len(bodies(cell))]
        pose = geometry.make_pose((0.8, -0.8 + 0.1 * (n % 3), 0.6), geometry.LEVEL)
        for _ in range(2):  # the second answer is from memory
            found = [camera.name for camera in kept.cameras(body, pose, poses.__getitem__)]
            assert found == [camera.name for camera in Sight(cell).cameras(body, pose, poses.__getitem__)]
        answers.add(tuple(found))
    assert len(answers) > 1
