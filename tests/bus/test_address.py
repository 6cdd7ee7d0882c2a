"""Where the bus is, and what may be said of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.bus import address
from station.bus.address import BusAddress
from station.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("redis://robot:7000/3", BusAddress(host="robot", port=7000, db=3)),
        ("redis://robot", BusAddress(host="robot")),
        ("rediss://:s%40cret@robot/0", BusAddress(host="robot", password="s@cret", tls=True)),
        ("redis://me:pw@robot", BusAddress(host="robot", username="me", password="pw")),
        ("unix:///run/bus.sock", BusAddress(socket="/run/bus.sock")),
        ("unix:///run/bus.sock?db=2", BusAddress(socket="/run/bus.sock", db=2)),
    ],
)
def test_urls_are_read_and_written_back(text: str, expected: BusAddress) -> None:
    assert address.parse(text) == expected
    assert address.parse(expected.url) == expected


@pytest.mark.parametrize("text", ["robot:6379", "http://robot", "redis://robot:port", "redis://robot/x", "unix://"])
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match=r"expected redis://HOST:PORT/DB"):
        address.parse(text)


def test_a_password_is_never_shown() -> None:
    secret = address.parse("redis://me:hunter2@robot")
    assert "hunter2" not in f"{secret} {secret!r}"
    with pytest.raises(ConfigError) as caught:
        address.parse("redis://me:hunter2@robot:port")
    assert "hunter2" not in str(caught.value)


def test_the_password_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATION_BUS_PASSWORD", "hunter2")
    assert address.parse("redis://robot").password == "hunter2"


def test_the_default_is_a_socket_that_only_this_user_can_open(monkeypatch: pytest.MonkeyPatch) -> None:
    default = address.default()
    assert default.socket is not None
    assert Path(default.socket).parent.stat().st_mode & 0o077 == 0
    monkeypatch.setenv("STATION_BUS", "redis://robot")
    assert address.default() == BusAddress(host="robot")


def test_a_runtime_folder_open_to_others_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "station").mkdir(mode=0o777)
    (tmp_path / "station").chmod(0o777)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    if len(str(tmp_path)) < 80:
        with pytest.raises(ConfigError, match="mode 0700"):
            address.runtime_folder()


def test_runtime_folders_too_long_for_a_socket_do_not_meet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = []
    for name in ("a", "b"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / (name * 120)))
        found.append(address.runtime_folder())
    try:
        assert found[0] != found[1]
        assert all(len(str(folder / "bus.sock")) < 100 for folder in found)
    finally:
        for folder in found:
            folder.rmdir()
