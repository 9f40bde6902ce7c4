"""Masses and inertias that a URDF leaves out, or that no body has: replaced by those of a body of its size."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
from scipy.spatial import ConvexHull

from rtc.model.cells.urdf import number
from rtc.spatial.geometry import Array

GYRATION = 1.0  # greatest plausible radius of gyration, as a share of the size of a link
# Of published arms with true masses the whole mass over the volume of all hulls is 760 to 1,510 kg/m3, its median
# 1,000 (n = 9: Panda, xArm 6 and 7, UR3, UR5, UR10, Kinova, Z1, iiwa 7).
DENSITY_KG_M3 = 1000.0  # of a link without a mass
POINT_M = 0.01  # radius of a ball with the mass of a link that has no moments
INERTIA = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))


def by_size(link: ElementTree.Element, points: Array) -> float:
    """Give a link the mass and the inertia of a solid of its outline (m, [n][3]). Returns the mass in kg."""
    low, high = points.min(axis=0), points.max(axis=0)
    kilograms = DENSITY_KG_M3 * float(ConvexHull(points).volume)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(f"{x:.5g}" for x in 0.5 * (low + high)), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=f"{kilograms:.4g}")
    ElementTree.SubElement(inertial, "inertia", _of_box(kilograms, high - low))
    return kilograms


def made_possible(inertial: ElementTree.Element | None) -> bool:
    """Raise the smaller principal moments until they are those of a body; True if that was necessary.

    Their sum is at least the greatest one. A mass without moments gets those of a small ball."""
    inertia, mass = (None if inertial is None else inertial.find(tag) for tag in ("inertia", "mass"))
    if inertia is None:
        return False
    matrix = np.array([[number(inertia, key) for key in row] for row in INERTIA])
    moments, axes = np.linalg.eigh(matrix)
    given, least = moments.copy(), 0.4 * (0.0 if mass is None else number(mass, "value")) * POINT_M**2
    if moments[0] <= 0.0:
        moments = np.maximum(moments, max(least, 1e-3 * float(moments[2])))
    missing = float(moments[2] - moments[0] - moments[1])
    if missing > 1e-9:
        moments[:2] += 0.505 * missing
    if np.array_equal(moments, given):
        return False
    fitted = axes @ np.diag(moments) @ axes.T
    for row, keys in enumerate(INERTIA):
        for column, key in enumerate(keys):
            inertia.set(key, f"{fitted[row, column]:.6g}")
    return True


def made_plausible(link: ElementTree.Element, outline: Array) -> bool:
    """Replace an inertia whose radius of gyration is beyond the size of the link by that of a solid box."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None or not number(mass, "value") > 0.0:
        return False
    kilograms, size = number(mass, "value"), outline.max(axis=0) - outline.min(axis=0)
    greatest = max(number(inertia, key) for key in ("ixx", "iyy", "izz"))
    if math.sqrt(greatest / kilograms) <= GYRATION * float(np.linalg.norm(size)):
        return False
    inertia.attrib = _of_box(kilograms, size)
    return True


def _of_box(kilograms: float, size: Array) -> dict[str, str]:
    """The attributes of the <inertia> of a solid box."""
    x, y, z = (size**2).tolist()
    moments = {"ixx": y + z, "iyy": x + z, "izz": x + y}
    return dict.fromkeys(("ixy", "ixz", "iyz"), "0") | {
        key: f"{kilograms / 12.0 * value:.4g}" for key, value in moments.items()
    }
