"""``station view``: what is refused, and with which words."""

from __future__ import annotations

import pytest

from tests.cli.conftest import Wave
from tests.cli.running import Home, one_line


def test_a_picture_needs_an_episode(home: Home) -> None:
    line = one_line(home.run("view", "--plot", "latest"))
    assert line == "--plot draws an episode; name it first: station view EPISODE --plot [FILE]"


def test_a_picture_is_a_png(home: Home) -> None:
    line = one_line(home.run("view", "latest", "--contact-sheet", "sheet.jpg"))
    assert line.startswith("--contact-sheet sheet.jpg: expected a file that ends in .png")


@pytest.mark.parametrize("option", [("--for", "1s"), ("--bus", "unix:///nowhere")])
def test_what_is_for_a_running_station_is_refused_for_an_episode(home: Home, option: tuple[str, str]) -> None:
    assert one_line(home.run("view", "latest", *option)).startswith(f"{option[0]} is for a running station")


def test_an_episode_without_a_robot_has_a_plot_and_no_contact_sheet(wave: Wave) -> None:
    drawn = wave.home.run("view", str(wave.episode), "--plot")
    assert drawn.stdout == f"saved {wave.episode / 'plot.png'}\n"
    refused = one_line(wave.home.run("view", str(wave.episode), "--contact-sheet"))
    assert refused == f"{wave.episode.name}: no contact sheet, it holds no pose of a robot"
