"""The arm's model is one that any simulator takes as it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest


@pytest.fixture(scope="module")
def root(cell):
    return ET.fromstring(cell.urdf("RIGHT-ARM"))


def test_every_inertia_is_that_of_a_rigid_body(root):
    inertias = {link.get("name"): link.find("inertial/inertia") for link in root.iter("link")}
    bodies = {link.get("name") for link in root.iter("link") if link.find("collision") is not None}
    assert set(inertias) - bodies == {"tcp"}  # a frame only
    for name in bodies:
        entry = inertias[name]
        assert entry is not None, f"pybullet would give {name} 1 kg and 1 kg m2"
        rows = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
        a, b, c = np.linalg.eigvalsh([[float(entry.get(key)) for key in row] for row in rows])
        assert a > 0, name
        assert a + b >= c, f"{name} breaks the triangle rule: {a} + {b} < {c}"


def test_shapes_are_primitive_and_the_lines_short(root, cell):
    shapes = [shape.tag for shape in root.findall(".//collision/geometry/*")]
    assert len(shapes) == 12
    assert set(shapes) <= {"box", "cylinder", "sphere"}
    assert max(len(line) for line in cell.urdf("RIGHT-ARM").splitlines()) < 1000  # Bullet reads line by line


def test_the_sensor_reports_about_its_own_origin(root):
    sensor = root.find("link[@name='sensor']/inertial/origin")
    assert sensor.get("xyz") == "0 0 0"
    mount = root.find("joint[@name='wrist_ft']")
    assert mount.get("type") == "fixed"
    assert mount.find("child").get("link") == "sensor"


def test_disabled_pairs_name_links_that_exist(root, cell):
    links = {link.get("name") for link in root.iter("link")}
    rows = list(ET.fromstring(cell.srdf("RIGHT-ARM")).iter("disable_collisions"))
    assert rows
    assert all({row.get("link1"), row.get("link2")} <= links for row in rows)


def test_masses_are_the_published_ones(cell):
    model = pin.buildModelFromXML(cell.urdf("RIGHT-ARM"))
    masses = [inertia.mass for inertia in model.inertias]
    hand = 0.2 + 0.5  # sensor and palm move with joint 6
    assert np.allclose(masses[1:7], [10, 17.4, 4.8, 0.82, 0.34, 0.09 + hand])
