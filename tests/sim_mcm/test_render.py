"""The picture: a real PNG, with the things of the cell where the truth says."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from PIL import Image

from rtc.drawing.renderer import LIMIT_S, Renderer
from rtc.drawing.scene import VIEWS, CameraPicture, Panel, Picture, SceneView, true_scene
from rtc.model.cells.parts import Camera
from rtc.protocol import messages as m
from rtc.protocol.outcomes import RtcError
from rtc.sensing.optics import Window
from sim_mcm.cameras import render


@pytest.mark.physics
def test_a_picture_shows_what_has_moved(tmp_path, cell) -> None:
    pose = cell.object_pose("MACS-NEW").tolist()
    lifted = [pose[0], pose[1], pose[2] + 0.3, *pose[3:]]
    truth = m.SimTruthReply(
        request="1", sim_s=0.0, poses={"MACS-NEW": lifted}, velocities={}, tcp={}, joints={}, fingers={}, held={}
    )
    files = [str(tmp_path / name) for name in ("a.png", "b.png")]
    with Renderer() as renderer:  # both are ordered before one is drawn
        for file, scene in zip(files, (SceneView(), true_scene(truth)), strict=True):
            renderer.request(Picture(out=file, cell="swapout", panels=[Panel(title="", scene=scene)], smooth=False))
        assert renderer.drawn(LIMIT_S)
        assert renderer.drawn(LIMIT_S)

    before, after = (np.asarray(Image.open(file)).astype(int) for file in files)

    changed = (np.abs(before - after).max(axis=2) > 12).mean()
    assert 0.002 < changed < 0.2


SHOWN = ("RIGHT-END-EFF", "RACK-2", "MACS-OLD", "BAY-2-FRONT")  # in close views


@pytest.mark.physics
def test_a_picture_of_two_scenes_outlines_what_is_elsewhere(tmp_path, cell) -> None:
    begun = {thing.name: cell.object_pose(thing.name).tolist() for thing in cell.objects}
    moved = begun | {"MACS-OLD": [n + d for n, d in zip(begun["MACS-OLD"], (-0.05, 0, 0.02, 0, 0, 0, 0), strict=True)]}
    panels = [
        Panel(title="believed", scene=SceneView(poses=begun), labels={"MACS-OLD": "MACS-OLD"}),
        Panel(title="true", scene=SceneView(poses=moved), labels={"RIGHT-ARM": "RIGHT-ARM"}, outlined=["MACS-OLD"]),
    ]
    studio = render.SceneRenderer(cell)
    for camera in ("overview", "MACS-OLD"):
        wanted = Picture(out="", cell="swapout", panels=panels, camera=camera, caption=["words"], smooth=False)
        made = np.asarray(render.compose(studio, wanted))
        outlined = (made == render.sheet.OUTLINE).all(axis=2).sum(axis=0).nonzero()[0]
        assert outlined.min() > made.shape[1] / 2, camera  # in the right panel alone
    cameras = [studio.camera(name, panels[1].scene, 1.0) for name in (*VIEWS, *SHOWN)]
    assert len(set(cameras)) == len(cameras)
    with pytest.raises(RtcError, match="NOWHERE"):
        render.compose(studio, Picture(out="", cell="swapout", panels=panels, camera="NOWHERE"))
    studio.close()


@pytest.mark.physics
def test_the_renderer_answers_each_request_and_ends_with_its_stdin(tmp_path) -> None:
    with Renderer() as renderer:
        panels = [Panel(title="a", scene=SceneView())]
        renderer.draw(Picture(out=str(tmp_path / "a.png"), cell="swapout", panels=panels, smooth=False))
        renderer.draw(
            CameraPicture(out=str(tmp_path / "b.png"), cell="swapout", camera="CAMERA-1", scene=SceneView(), seed=1)
        )
        with pytest.raises(RtcError, match=r"no picture: .*no-such-directory"):
            renderer.draw(
                Picture(out="/no-such-directory/a.png", cell="swapout", panels=[Panel(title="", scene=SceneView())])
            )
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.png", "b.png"]
    with Image.open(tmp_path / "b.png") as picture:
        assert picture.size == (640, 480)


LENS = {"xyz": (0.5, -1.3, 1.25), "looks_at": (0.78, -0.8, 0.64), "size_px": (160, 120)}
CAMERAS = (
    Camera(name="CLEAR", **LENS),
    Camera(name="NOISY", noise=8, **LENS),
    Camera(name="DARK", exposure=0.01, **LENS),
    Camera(name="HAND", arm="RIGHT-ARM", xyz=(0.1, 0, -0.2), looks_at=(0, 0, 1), up=(1, 0, 0), size_px=(160, 120)),
)


@pytest.mark.physics
def test_the_sensor_of_a_camera_has_noise_and_an_exposure(cell) -> None:
    studio = render.SceneRenderer(msgspec.structs.replace(cell, cameras=[*CAMERAS]))
    scene = SceneView()
    studio.pose(scene)
    clear, dark = studio.camera_picture("CLEAR", scene).astype(int), studio.camera_picture("DARK", scene)
    noisy = [studio.camera_picture("NOISY", scene, seed).astype(int) for seed in (1, 1, 2)]
    with pytest.raises(RtcError, match="HAND is on RIGHT-ARM"):
        studio.camera_picture("HAND", scene)
    here = [
        studio.camera_picture("HAND", SceneView(tcp={"RIGHT-ARM": [0.5, y, 0.6, 0, 0.7071, 0, 0.7071]}))
        for y in (0, -0.8)
    ]
    studio.close()

    assert clear.shape == (120, 160, 3)
    assert dark.max() <= 3 < clear.min() + 100
    middle = (clear > 40) & (clear < 215)  # nothing is cut off there
    assert 7.5 < (noisy[0] - clear)[middle].std() < 8.5
    assert np.array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[0], noisy[2])
    assert not np.array_equal(*here)  # the camera moves with the hand


@pytest.mark.physics
def test_a_window_has_the_pixels_of_the_whole_picture(cell) -> None:
    camera = Camera(name="CLEAR", xyz=(-0.1, 0.0, 1.1), looks_at=(0.8, 0.0, 0.72), size_px=(320, 240))
    studio, scene = render.SceneRenderer(msgspec.structs.replace(cell, cameras=[camera])), SceneView()
    studio.pose(scene)
    whole = studio.camera_picture("CLEAR", scene)
    for window in (Window(50, 46, 47, 44), Window(0, 0, 20, 30), Window(280, 200, 40, 40)):
        left, top, width, height = window
        part = studio.camera_picture("CLEAR", scene, window=window)
        assert np.array_equal(part, whole[top : top + height, left : left + width])
    studio.close()


@pytest.mark.physics
def test_the_computed_floor_of_a_camera_is_where_the_drawn_one_is(cell) -> None:
    """Tile by tile, up to their edges and the horizon."""
    camera = Camera(name="FLOOR", xyz=(0.5, -1.3, 0.8), looks_at=(0.9, 0.3, 0.4), size_px=(160, 120))
    studio = render.SceneRenderer(msgspec.structs.replace(cell, cameras=[camera]))
    matrices = render.lens.matrices(camera, camera.pose)
    seen = studio.photograph(render.RenderCamera(matrices.view, matrices.lens), *camera.size_px, smooth=False).bodies
    tiles = {tile: n for n, (tile, _) in enumerate(studio._floor)}
    computed = render.backdrop(camera, camera.pose)
    studio.close()

    sky = np.all(computed == render.SKY, axis=-1)
    light = computed[..., 0] > 200
    on_floor = np.isin(seen, list(tiles))
    parity = np.array([sum(divmod(tiles[body], render.FLOOR_TILES)) % 2 for body in seen[on_floor]])
    assert on_floor.sum() > 4_000
    assert (seen < 0).sum() > 500
    assert sky[seen < 0].mean() > 0.98
    assert (light[on_floor] == (parity == 0)).mean() > 0.97
