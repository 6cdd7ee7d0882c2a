"""A run as a page of pictures, and what is said where none can be drawn."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.episode.reading.reader import EpisodeReader, open_episode
from station.errors import StationError
from station.view import offscreen, plot_style
from station.view.contact_sheet import save_sheet
from station.view.offscreen import CannotRender
from tests.episode.synthetic import EpisodeBuilder, command, walk
from tests.view import arms
from tests.view.pictures import pixels, share
from tests.view.robots import tiny

pytestmark = pytest.mark.usefixtures("processes")

LYING = (0.6, 0.8, 0.0, 0.0)


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path / "data")


@pytest.fixture
def walked(builder: EpisodeBuilder) -> EpisodeReader:
    walk(builder, seconds=1.0)
    return open_episode(builder.finish())


@pytest.mark.usefixtures("drawing_machine")
def test_a_walk_becomes_a_page_of_fifteen_pictures(walked: EpisodeReader, tmp_path: Path) -> None:
    path = tmp_path / "sheet.png"
    save_sheet(walked, path, robot_model=tiny(tmp_path))
    picture = pixels(path)
    assert picture.shape[1] == plot_style.WIDTH_PX
    assert 1000 < picture.shape[0] < 1600
    reddish = (picture[..., 0] > 120) & (picture[..., 1] < 90) & (picture[..., 2] < 90)
    seen = reddish[88:].any(axis=0)
    assert np.count_nonzero(np.diff(seen.astype(int)) == 1) >= 5, "the red pelvis is in each of five columns"
    assert share(picture, plot_style.FELL) < 0.01
    assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []


@pytest.mark.usefixtures("drawing_machine")
def test_a_robot_that_has_fallen_is_framed(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=1.0, quat=LYING, height=0.1)
    save_sheet(open_episode(builder.finish()), tmp_path / "sheet.png", robot_model=tiny(tmp_path))
    assert share(pixels(tmp_path / "sheet.png"), plot_style.FELL, within=8) > 0.01


@pytest.mark.usefixtures("drawing_machine")
def test_with_cameras_a_column_shows_what_each_saw_at_its_moment(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=1.0)
    for frame in range(30):  # one goes from blue to green, the other is silent until the middle and then broken
        colour = (0, 8 * frame, 255 - 8 * frame)
        builder.write({keys.camera_image("head"): jpeg(colour)}, at_s=frame / 30, writer="camera")
        if frame > 15:
            builder.write({keys.camera_image("wrist"): b"no picture"}, at_s=frame / 30, writer="camera")
    save_sheet(open_episode(builder.finish()), tmp_path / "sheet.png", robot_model=tiny(tmp_path))
    page = pixels(tmp_path / "sheet.png").astype(int)
    below = page[88 + 340 + 40 :]
    seen = (below.max(axis=2) > 100) & (below[..., 0] < 20)
    columns = [slice(left, left + 310) for left in range(32, 1290, 310)]
    greens = [below[:, column, 1][seen[:, column]].mean() for column in columns]
    assert greens == sorted(greens)
    assert greens[-1] - greens[0] > 100
    assert share(page[-80:].astype(np.uint8), plot_style.FELL, within=60) > 0.0005, "it says that there is no picture"


def jpeg(colour: tuple[int, int, int]) -> bytes:
    made = io.BytesIO()
    Image.new("RGB", (320, 240), colour).save(made, format="jpeg")
    return made.getvalue()


@pytest.mark.parametrize("gl", ["disable", "bogus"])
def test_where_drawing_is_switched_off_the_reason_says_so(walked: EpisodeReader, tmp_path: Path, gl: str) -> None:
    with pytest.raises(CannotRender, match=rf"cannot render \(\$MUJOCO_GL is '{gl}'; expected egl, osmesa, glfw\)"):
        save_sheet(walked, tmp_path / "sheet.png", robot_model=tiny(tmp_path), gl=gl)
    assert not (tmp_path / "sheet.png").exists()


def test_where_no_way_works_each_ones_reason_is_told(
    walked: EpisodeReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nowhere")
    with pytest.raises(CannotRender, match=r"this machine cannot render \(egl: ") as caught:
        save_sheet(walked, tmp_path / "sheet.png", robot_model=tiny(tmp_path), gl="egl")
    assert "\n" not in str(caught.value)


def test_a_child_that_is_killed_takes_nothing_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("import os; os.abort()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(CannotRender, match="egl: killed by SIGABRT"):
        offscreen.render(tmp_path / "m.xml", np.zeros((1, 7)), (), np.zeros((1, 0)), width=8, height=8, gl="egl")


def test_an_episode_without_a_pose_has_no_contact_sheet(builder: EpisodeBuilder, tmp_path: Path) -> None:
    builder.write({twist_keys.action_body(): codec.json_vector(command())}, at_s=0.1, writer="motion")
    with pytest.raises(StationError, match="no contact sheet, it holds no pose of a robot"):
        save_sheet(open_episode(builder.finish()), tmp_path / "sheet.png")


@pytest.mark.usefixtures("drawing_machine")
def test_an_arm_is_seen_in_each_picture(builder: EpisodeBuilder, tmp_path: Path) -> None:
    arms.reach(builder)
    path = tmp_path / "sheet.png"
    assert save_sheet(open_episode(builder.finish()), path) == []
    picture = pixels(path)
    orange = (picture[..., 0] > 150) & (picture[..., 1] < 130) & (picture[..., 2] < 70)
    seen = orange[88:].any(axis=0)
    assert np.count_nonzero(np.diff(seen.astype(int)) == 1) >= 5, "the caps of its hinges are in each of five columns"
