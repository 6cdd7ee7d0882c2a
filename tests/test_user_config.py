"""Defaults of a user: after what is named and the environment, before our own."""

from __future__ import annotations

import getpass
from pathlib import Path

import pytest

from station import user_config
from station.bus import address
from station.episode.storage.folder import data_folder
from station.errors import ConfigError
from tests.cli.running import Home, new_home, one_line


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this user's defaults are kept; not there yet."""
    for name in ("STATION_DATA", "STATION_BUS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "station").mkdir(mode=0o700)
    return tmp_path / "station" / "config.yaml"


def test_without_a_file_ours_hold(file: Path) -> None:
    assert data_folder() == Path("data")
    assert address.default() == address.own()
    assert user_config.operator() == getpass.getuser()


def test_they_come_after_what_is_named_and_the_environment(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.write_text("data: episodes\nbus: redis://lab:6380\noperator: ada\n")
    assert data_folder() == file.parent / "episodes", "beside the file, whatever the current folder is"
    assert str(address.default()) == "redis://lab:6380/0"
    assert (user_config.operator(), user_config.operator("eve")) == ("ada", "eve")
    assert data_folder(Path("other")) == Path("other")
    monkeypatch.setenv("STATION_DATA", "/from/environment")
    monkeypatch.setenv("STATION_BUS", "redis://other:1")
    assert data_folder() == Path("/from/environment")
    assert str(address.default()) == "redis://other:1/0"


def test_a_change_is_seen_and_a_mistake_told_with_its_file(file: Path) -> None:
    file.write_text("data: /one\n")
    assert data_folder() == Path("/one")
    file.unlink()
    assert data_folder() == Path("data")
    file.write_text("dta: /two\n")
    with pytest.raises(
        ConfigError, match=r"config\.yaml: unknown key 'dta' \(did you mean 'data'\?\); known: bulk, bus, data"
    ):
        data_folder()


@pytest.mark.usefixtures("processes")
def test_the_command_line_takes_them_and_doctor_shows_them(tmp_path: Path) -> None:
    config = tmp_path / "station" / "config.yaml"
    config.parent.mkdir()
    config.write_text(f"data: {tmp_path}/mine\nbus: redis://:secret@lab:6380\noperator: ada\n")
    with new_home() as home:
        there: Home = home.without("STATION_DATA")
        there.environment["XDG_CONFIG_HOME"] = str(tmp_path)
        assert f"no episodes in {tmp_path}/mine" in there.run("episodes", "list").stdout
        told = next(item for item in there.json("doctor") if item["subject"] == "defaults")
        assert told["found"] == f"data {tmp_path}/mine, bus redis://lab:6380/0, operator ada ({config})"
        config.write_text("data: [1]\n")
        assert f"{config}: data: expected a path, got [1]" in one_line(there.run("episodes", "list"))
