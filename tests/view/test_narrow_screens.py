from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from station.life.server import Health
from station.view.status import KeyStatus, Status, render

KEY = "action_body_unitree_g1_with_hands"


def shown(width: int) -> str:
    now_ns = time.time_ns()
    server = Health(
        name="g1", role="low-level", state="active", pid=12345, host="h", boot="b", source="s",
        started_wall_ns=now_ns, wall_ns=now_ns, config_sha256="", rate_hz=50.0, jitter_p50_ms=0.01, jitter_p99_ms=0.22,
        overruns=3, lost_writes=12,
    )  # fmt: skip
    status = Status("unix:///x", [server], [KeyStatus(KEY, "command", "motion.1234.ab12", 50.0, 0.012)])
    console = Console(width=width, file=io.StringIO())
    console.print(render(status, width))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize("width", [60, 72, 80, 120])
def test_a_narrow_screen_shows_fewer_columns_and_cuts_none(width: int) -> None:
    text = shown(width)
    assert "…" not in text
    assert all(word in text for word in (KEY, "50.0 Hz", "12 ms", "lost writes", "overruns"))


@pytest.mark.parametrize("height", [10, 14, 40])
def test_a_low_screen_says_how_many_keys_it_has_no_room_for(height: int) -> None:
    keys = [KeyStatus(f"key_{number}", "state", "g1.1.a", 50.0, 0.01) for number in range(30)]
    console = Console(width=80, file=io.StringIO())
    console.print(render(Status("unix:///x", [], keys), 80, height))
    assert isinstance(console.file, io.StringIO)
    lines = console.file.getvalue().splitlines()
    assert len(lines) <= height
    shown = sum(line.startswith("key_") for line in lines)
    assert shown == 30 or f"and {30 - shown} more keys" in lines[-1]
    assert (shown == 30) == (height == 40)


def test_a_wide_screen_shows_all() -> None:
    assert all(word in shown(120) for word in ("motion.1234.ab12", "0.01 / 0.22 ms", "12345"))
