"""``station demo``: with upstream data the whole main job; without it the command half, and that it says so."""

from __future__ import annotations

import pytest

from tests.cli.running import Home


def test_without_upstream_data_the_command_half_runs_and_says_so(home: Home) -> None:
    done = home.without("STATION_ASSETS").run("demo", "--for", "1s")
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("$STATION_ASSETS is not set, so there is no policy and no robot model")
    assert "docs/assets.md" in done.stderr.splitlines()[0]
    assert "0 lost, 0 falls" in done.stdout
    assert len(list((home.data / "demo").iterdir())) == 1


@pytest.mark.assets
@pytest.mark.usefixtures("assets")
def test_the_main_job_is_driven_recorded_checked_and_audited(home: Home) -> None:
    done = home.run("demo", "--for", "1s")
    assert done.returncode == 0, done.stderr
    assert "confirm: Fall zone is clear" in done.stderr
    assert "0 lost, 0 falls" in done.stdout
    assert "unitree_g1_with_hands: " in done.stdout
    assert " steps, 0 different" in done.stdout
    assert "next: station replay " in done.stdout


def test_upstream_data_in_no_folder_is_told(home: Home) -> None:
    home.environment["STATION_ASSETS"] = "/nowhere"
    done = home.run("demo", "--for", "1s")
    assert done.returncode == 1
    assert "$STATION_ASSETS names /nowhere, which is not a folder" in done.stderr
    assert done.stderr.splitlines()[-1] == "station: the demo recorded nothing; the lines above say why"
