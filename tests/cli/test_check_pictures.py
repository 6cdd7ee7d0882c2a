"""``station check`` of an episode with cameras: what a person sees of its pictures, and how far it has come."""

from __future__ import annotations

from pathlib import Path

from station.bus import keys
from tests.cli.at_terminal import AtTerminal
from tests.cli.running import Home
from tests.episode.scenes import Shot, file_of, filmed, noise, sound

SOON = "import station.cli.check as verb; verb._SOON_S = 0.0; from station.cli.main import main; main()"


def black_from_half_on(shot: Shot) -> bytes:
    return file_of(3.0 + noise(shot.number)) if shot.at_s >= 3.0 else sound(shot)


def test_the_verdict_names_camera_and_key_and_a_table_says_what_its_pictures_are_worth(
    home: Home, tmp_path: Path
) -> None:
    found = home.run("check", str(filmed(tmp_path, black_from_half_on)))
    assert found.returncode == 1
    assert f"reject camera-black: camera head ({keys.camera_image('head')}): 6 of 12 pictures" in found.stdout
    head, row = [line.split() for line in found.stdout.splitlines()[-2:]]
    assert head[:4] == ["pictures", "size", "torn", "repeats"]
    assert row[:4] == ["head", "320x240", "0", "0"]
    assert found.stderr == "", "no progress where nobody looks"


def test_a_check_that_takes_long_says_at_a_terminal_how_far_it_is(home: Home, tmp_path: Path) -> None:
    with AtTerminal(home, "check", str(filmed(tmp_path, sound)), program=("-c", SOON)) as terminal:
        assert terminal.finish() == 0
        assert "checking" in terminal.screen
