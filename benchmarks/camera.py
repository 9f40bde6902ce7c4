"""How exactly does a camera locate a module by its AprilTags, over distance and angle, and at which rate?

The renderer of the cell draws pictures of 640 x 480 pixels with noise. The detector gets the pixels alone; the truth is
compared afterwards. Four tags of 48 mm (60 mm with their border) are on top of the module. The budget is that of four
tags at 0.6 to 1.2 m, tilted by 0 to 50 degrees. It is 1 mm and 0.4 degrees in the median.

    python -m benchmarks.camera [--trials 40]
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.report import RESULTS, finish, percentile, question
from rtc.drawing.scene import SceneView
from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera, Frame, Tag
from rtc.sensing import locate, optics
from rtc.sensing.detector import TagDetector
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.cameras import render

SEED = 5
MODULE = "MACS-NEW"
NOISE = 3.0  # of a pixel
TOP_M = 0.0805  # of the tags above the module's middle
TAGS = [
    Tag(id=n, body=MODULE, size_m=0.048, frame=Frame(xyz=(x, y, TOP_M)))
    for n, (x, y) in enumerate(((0.05, 0.08), (0.05, -0.08), (-0.05, 0.08), (-0.05, -0.08)))
]
BUDGET_R_M, BUDGET_TILT_DEG = (0.6, 1.2), (0.0, 50.0)
DISTANCES_M = (0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 1.8)
TILTS_DEG = (0, 15, 30, 45, 60, 70, 78)
SECOND_TILT_DEG, APART_DEG = 40.0, 120.0  # the second camera of a pair: its tilt, and its azimuth against the first
#: title -> (number of tags, number of cameras)
SETS = {"1 tag": (1, 1), "4 tags": (4, 1), "4 tags, 2 cameras": (4, 2)}


class Geometry(NamedTuple):
    """Where a camera is, seen from the tags: distance (m), tilt against their normal and azimuth (rad)."""

    distance_m: float
    tilt_rad: float
    azimuth_rad: float


class Shot(NamedTuple):
    """Pictures of one module pose by two cameras, and the time that each stage took (s of processor time)."""

    truth: Array
    pictures: list[locate.Seen]
    draw_s: float
    detect_s: float


class Trial(NamedTuple):
    found: bool
    off_mm: float = math.nan
    off_deg: float = math.nan
    squared: float = math.nan  # error in units of its covariance, squared; 6 in the mean
    fit_s: float = math.nan


def random_poses(count: int, seed: int = SEED) -> list[Geometry]:
    """Uniform in the range of the budget."""
    random = np.random.default_rng(seed)
    return [
        Geometry(
            random.uniform(*BUDGET_R_M), math.radians(random.uniform(*BUDGET_TILT_DEG)), random.uniform(0, 2 * math.pi)
        )
        for _ in range(count)
    ]


def shots(views: Sequence[Geometry], cameras: int = 2, seed: int = SEED) -> list[Shot]:
    """Pictures from all these places; the module is turned and displaced at random."""
    random = np.random.default_rng(seed)
    cell = Cell.load("swapout")
    middle = cell.object_pose(MODULE)[:3] + np.array((0.0, 0.0, TOP_M))
    pairs = []
    for n, view in enumerate(views):
        turned = view.azimuth_rad + math.radians(APART_DEG)
        beside = Geometry(view.distance_m, math.radians(SECOND_TILT_DEG), turned)
        places = (view, beside)[:cameras]
        pairs.append([_camera(f"CAMERA-{n}-{side}", middle, at) for side, at in enumerate(places)])
    every = [camera for pair in pairs for camera in pair]
    studio, detector = render.SceneRenderer(msgspec.structs.replace(cell, cameras=every, tags=TAGS)), TagDetector()
    done = []
    for n, pair in enumerate(pairs):
        turn = geometry.from_rpy(random.uniform(-0.03, 0.03, 3), random.uniform(-0.1, 0.1, 3))
        truth = geometry.compose(cell.object_pose(MODULE), turn)
        scene = SceneView(poses={MODULE: truth.tolist()})
        studio.pose(scene)
        begun = time.process_time()
        images = [studio.camera_picture(camera.name, scene, seed=2 * n + side) for side, camera in enumerate(pair)]
        drawn = time.process_time()
        seen = [
            locate.Seen(optics.view(camera), detector.find(image)) for camera, image in zip(pair, images, strict=True)
        ]
        done.append(Shot(truth, seen, (drawn - begun) / cameras, (time.process_time() - drawn) / cameras))
    studio.close()
    return done


def evaluate(shot: Shot, tags: int = 4, cameras: int = 1) -> Trial:
    """The error of the pose that the first tags and cameras give."""
    begun = time.process_time()
    fit = locate.locate(TAGS[:tags], shot.pictures[:cameras]).get(MODULE)
    took_s = time.process_time() - begun
    if fit is None:
        return Trial(False)
    error = np.concatenate([shot.truth[:3] - fit.pose[:3], geometry.rotation_vector(fit.pose, shot.truth)])
    return Trial(
        True,
        1e3 * geometry.distance(fit.pose, shot.truth),
        math.degrees(geometry.angle(fit.pose, shot.truth)),
        float(error @ np.linalg.solve(fit.covariance, error)),
        took_s,
    )


def trials(views: Sequence[Geometry], tags: int = 4, cameras: int = 1, seed: int = SEED) -> list[Trial]:
    return [evaluate(shot, tags, cameras) for shot in shots(views, cameras, seed)]


def _camera(name: str, middle: Array, view: Geometry) -> Camera:
    aside, up = view.distance_m * math.sin(view.tilt_rad), view.distance_m * math.cos(view.tilt_rad)
    at = middle + np.array((aside * math.cos(view.azimuth_rad), aside * math.sin(view.azimuth_rad), up))
    return Camera(name=name, xyz=_three(at), looks_at=_three(middle), up=(1.0, 0.02, 0.01), noise=NOISE)


def _three(point: Array) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def summary(done: Sequence[Trial]) -> dict[str, float]:
    """Median and p95 of the errors of those found, and the share of those found."""
    found = [trial for trial in done if trial.found]
    figures = {"found": len(found) / len(done)}
    for name in ("off_mm", "off_deg"):
        values = [getattr(trial, name) for trial in found]
        figures |= {f"{name}_p{p}": percentile(values, p) if values else math.nan for p in (50, 95)}
    figures["squared"] = float(np.median([trial.squared for trial in found])) if found else math.nan
    return figures


def curves(count: int) -> dict[str, dict[str, list[dict[str, float]]]]:
    """Summaries by set of tags, over distance (all tilts of the budget) and over tilt (0.9 m)."""
    random = np.random.default_rng(SEED)
    turns = random.uniform(0, 2 * math.pi, count)
    tilts = np.radians(random.uniform(*BUDGET_TILT_DEG, count))
    by_distance = [
        shots([Geometry(r, tilt, turn) for tilt, turn in zip(tilts, turns, strict=True)]) for r in DISTANCES_M
    ]
    by_tilt = [shots([Geometry(0.9, math.radians(tilt), turn) for turn in turns]) for tilt in TILTS_DEG]
    return {
        title: {
            "distance": [summary([evaluate(shot, *which) for shot in at]) for at in by_distance],
            "tilt": [summary([evaluate(shot, *which) for shot in at]) for at in by_tilt],
        }
        for title, which in SETS.items()
    }


def plot(found: dict[str, dict[str, list[dict[str, float]]]]) -> None:
    """results/camera.png; skipped without matplotlib."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, axes = pyplot.subplots(2, 2, figsize=(11, 7.5), sharey="row", constrained_layout=True)
    columns = (("distance", DISTANCES_M, "distance (m), tilt 0 to 50 deg"), ("tilt", TILTS_DEG, "tilt (deg), at 0.9 m"))
    lines = (("off_mm", "position error (mm)", 1.0), ("off_deg", "attitude error (deg)", 0.4))
    for row, (name, label, budget) in enumerate(lines):
        for column, (key, places, title) in enumerate(columns):
            axis = axes[row][column]
            for number, (what, figures) in enumerate(found.items()):
                p50, p95 = ([point[f"{name}_p{p}"] for point in figures[key]] for p in (50, 95))
                axis.plot(places, p50, "o-", color=f"C{number}", label=f"{what}: median")
                axis.plot(places, p95, "--", color=f"C{number}", alpha=0.6, label=f"{what}: p95")
            axis.axhline(budget, color="black", linewidth=0.8, linestyle=":", label="budget of 4 tags (median)")
            axis.set_yscale("log")
            axis.grid(alpha=0.3, which="both")
            axis.set_ylabel(label if column == 0 else "")
            axis.set_xlabel(title if row == 1 else "")
    handles, titles = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, titles, fontsize=8, ncols=4, loc="outside lower center")
    figure.suptitle("Pose of a module from AprilTags of 48 mm, 640 x 480 pixels, field of view 45 deg")
    figure.savefig(RESULTS / "camera.png", dpi=110)
    pyplot.close(figure)


def main() -> None:
    words = argparse.ArgumentParser(prog="python -m benchmarks.camera", description=__doc__)
    words.add_argument(
        "--trials", type=int, default=40, help="pictures per point of a curve; the budget gets three times as many"
    )
    count = words.parse_args().trials
    question("camera", __doc__.split("\n", 1)[0], seed=SEED)
    taken = shots(random_poses(3 * count))
    metrics: dict[str, float | None] = {}
    rows = []
    for title, which in SETS.items():
        done = [evaluate(shot, *which) for shot in taken]
        figures = summary(done)
        name = title.replace(",", "").replace(" ", "_")
        metrics |= {
            f"{name}_off_mm_p50": figures["off_mm_p50"],
            f"{name}_off_mm_p95": figures["off_mm_p95"],
            f"{name}_off_deg_p50": figures["off_deg_p50"],
            f"{name}_off_deg_p95": figures["off_deg_p95"],
            f"{name}_found": figures["found"],
        }
        words_ = f"median {figures['off_mm_p50']:.2f} mm, {figures['off_deg_p50']:.2f} deg; "
        words_ += f"p95 {figures['off_mm_p95']:.2f} mm, {figures['off_deg_p95']:.2f} deg; "
        words_ += f"found {100 * figures['found']:.1f} % of {len(done)}; "
        rows.append((title, words_ + f"squared error over covariance, median {figures['squared']:.1f} (5.3 expected)"))
        if title == "4 tags":
            fit_s = float(np.median([trial.fit_s for trial in done if trial.found]))
    draw_s, detect_s = (float(np.median([getattr(shot, name) for shot in taken])) for name in ("draw_s", "detect_s"))
    metrics |= {"draw_ms": 1e3 * draw_s, "detect_ms": 1e3 * detect_s, "fit_ms": 1e3 * fit_s}
    metrics |= {"rate_hz": 1.0 / (detect_s + fit_s), "rate_with_drawing_hz": 1.0 / (draw_s + detect_s + fit_s)}
    rows.append(
        ("one picture", f"draw {1e3 * draw_s:.0f} ms, detect {1e3 * detect_s:.0f} ms, fit {1e3 * fit_s:.1f} ms")
    )
    rows.append(("rate", f"{metrics['rate_hz']:.0f} Hz; {metrics['rate_with_drawing_hz']:.0f} Hz with the drawing"))
    found = curves(count)
    plot(found)
    finish("camera", metrics, rows, data={"distance_m": DISTANCES_M, "tilt_deg": TILTS_DEG, "curves": found})


if __name__ == "__main__":
    main()
