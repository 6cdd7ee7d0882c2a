"""A run as a page of plots: a real picture, whatever the episode lacks."""

from __future__ import annotations

import sys
from pathlib import Path
from subprocess import run as run_process

import matplotlib
import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from adapters.commands.velocity import VelocityCommand
from adapters.robots.g1 import twist_keys
from station.bus import codec, contracts, keys
from station.episode.reading.reader import open_episode
from station.errors import StationError
from station.report import story, tracking_plot
from station.view import plot_style as style
from station.view.plots import save_plot
from station.view.run import read_run
from tests.episode.synthetic import ROBOT, STANDING, EpisodeBuilder, command, tick, walk
from tests.view import arms
from tests.view.pictures import pixels, share


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path / "data")


def draw(builder: EpisodeBuilder, folder: Path) -> Path:
    return save_plot(open_episode(builder.finish()), folder / "plot.png")


def test_a_walk_becomes_a_page_with_both_curves(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(100):
        q = STANDING + 0.2 * np.sin(0.2 * number)
        tick(builder, number, at_s=0.02 * number, q=q, asked=command(q + 0.15),
             gate="entering" if number < 25 else "tracking")  # fmt: skip
    picture = pixels(draw(builder, tmp_path))
    height, width, _ = picture.shape
    assert width == style.WIDTH_PX
    assert 1000 < height < 1600
    assert share(picture, style.ASKED) > 0.002
    assert share(picture, style.MEASURED) > 0.002
    assert share(picture, style.PAPER) > 0.7
    assert share(picture, style.FELL) == 0.0
    assert [path.name for path in tmp_path.iterdir() if "part" in path.name] == []


def followed_velocity(builder: EpisodeBuilder, *, asks: bool) -> Path:
    """A robot that moves forward with 1 m/s, and is asked for it, or for joints."""
    used = keys.command_used(ROBOT)
    contract = contracts.contract(used)
    assert contract is not None
    if asks:
        builder.contracts[used] = msgspec.structs.replace(contract, elements=VelocityCommand(ROBOT).elements)
    for number in range(200):
        tick(builder, number, at_s=0.02 * number, asked=np.array([0.8, 0.0, 0.0]) if asks else None)
    return builder.finish({"servers": {"g1": {"robot": ROBOT, "rates": {"control_hz": 50.0}}}})


def test_velocities_have_panels_of_their_own(builder: EpisodeBuilder, tmp_path: Path) -> None:
    reader = open_episode(followed_velocity(builder, asks=True))
    run = read_run(reader)
    np.testing.assert_allclose(run.velocities[:, 1:], [[0.8, 0, 0, 1.0, 0, 0]] * len(run.velocities), atol=1e-6)
    assert len(run.velocities) == 200 - 50
    np.testing.assert_array_equal(story.read(reader).velocities, run.velocities)
    drawn = tracking_plot.draw(story.read(reader), {})
    assert drawn is not None
    (tmp_path / "report.png").write_bytes(drawn)
    assert share(pixels(tmp_path / "report.png"), style.ASKED) > 0.002
    with_them = pixels(save_plot(reader, tmp_path / "plot.png"))
    without = pixels(save_plot(open_episode(joints_alone(tmp_path)), tmp_path / "plot.png"))
    assert with_them.shape[0] > without.shape[0] + 100


def joints_alone(folder: Path) -> Path:
    reader = open_episode(followed_velocity(EpisodeBuilder(folder / "other"), asks=False))
    assert len(read_run(reader).velocities) == 0
    return reader.folder


def test_a_fall_is_marked(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=1.0)
    builder.event("fall", at_s=0.5, severity="error")
    assert share(pixels(draw(builder, tmp_path)), style.FELL) > 0.00005


def test_values_that_are_no_numbers_leave_gaps(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(50):
        q = STANDING + 0.1 * np.sin(0.3 * number)
        broken = (np.nan, np.nan, np.nan, np.nan) if number % 10 == 0 else (1.0, 0.0, 0.0, 0.0)
        q[3] = np.inf if number % 7 == 0 else q[3]
        q[5] = np.nan
        height = np.nan if number % 5 == 0 else 0.79
        tick(builder, number, at_s=0.02 * number, q=q, asked=command(), quat=broken, height=height)
    assert share(pixels(draw(builder, tmp_path)), style.MEASURED) > 0.002


def test_an_episode_without_a_robot_shows_what_was_commanded(builder: EpisodeBuilder, tmp_path: Path) -> None:
    for number in range(50):
        asked = command(STANDING + 0.1 * np.sin(0.3 * number))
        builder.write({twist_keys.action_body(): codec.json_vector(asked)}, at_s=0.02 * number, writer="motion")
    picture = pixels(draw(builder, tmp_path))
    assert share(picture, style.ASKED) > 0.002
    legend = picture[:60]
    assert share(picture, style.MEASURED) * picture.size == share(legend, style.MEASURED) * legend.size


def test_a_single_instant_is_drawn(builder: EpisodeBuilder, tmp_path: Path) -> None:
    tick(builder, 0, at_s=0.0)
    assert draw(builder, tmp_path).is_file()


def test_an_episode_without_joints_cannot_be_plotted(builder: EpisodeBuilder, tmp_path: Path) -> None:
    builder.event("mark", at_s=0.1)
    with pytest.raises(StationError, match="no plot, it holds neither a command nor a state"):
        draw(builder, tmp_path)
    assert not (tmp_path / "plot.png").exists()


def test_a_folder_that_is_not_there_is_one_line(builder: EpisodeBuilder, tmp_path: Path) -> None:
    walk(builder, seconds=0.1)
    with pytest.raises(StationError, match="cannot be written") as caught:
        draw(builder, tmp_path / "nowhere")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("processes")
def test_reading_the_module_loads_no_matplotlib() -> None:
    code = "import sys, station.view.plots, station.view.contact_sheet; print('matplotlib' in sys.modules)"
    assert run_process([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_an_arm_has_a_panel_for_each_joint_below_the_other(builder: EpisodeBuilder, tmp_path: Path) -> None:
    arms.reach(builder)
    picture = pixels(draw(builder, tmp_path))
    assert 900 < picture.shape[0] < 1300
    for row in range(7):  # the curve of each joint is in its own part of the page
        begins = 130 + row * (picture.shape[0] - 170) // 7
        assert share(picture[begins : begins + 130], style.MEASURED) > 0.0005
    assert share(picture, style.ASKED) > 0.002


@pytest.mark.parametrize(("name", "figure"), [("mean |error| [rad]", "left above right"), ("hip pitch", "0.031")])
@pytest.mark.parametrize("width", [0.09, 0.12, 0.16, 0.3])
def test_the_title_of_a_panel_and_its_figure_do_not_overlap(name: str, figure: str, width: float) -> None:
    with matplotlib.rc_context(style.RC):
        page = Figure(figsize=(style.WIDTH_PX / style.DPI, 4), dpi=style.DPI)
        canvas = FigureCanvasAgg(page)
        axes = page.add_axes((0.1, 0.2, width, 0.5))
        style.title(axes, name, figure)
        canvas.draw()
        drawn = [text for text in axes.findobj(Text) if text.get_text() in (name, figure)]
        assert len(drawn) == 2
        boxes = [text.get_window_extent(canvas.get_renderer()) for text in drawn]
    assert not boxes[0].overlaps(boxes[1])
