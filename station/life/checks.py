"""Automatic checks of a runbook: each returns what it found, or raises with the remedy."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from station import assets
from station.bus.client import Bus
from station.errors import ConfigError, NotReady
from station.life.runbook import CheckName, CheckStep

_BYTES_PER_GB = 1e9


def run(step: CheckStep, bus: Bus, data: Path) -> str:
    """Run a check.

    Args:
        step: The check and its arguments.
        bus: The station's bus.
        data: Folder of episodes.

    Returns:
        What was found, in a few words.

    Raises:
        NotReady: the check failed; the message says what to do.
        ConfigError: an argument that the check does not know.
    """
    check = _CHECKS[step.check]
    try:
        return check(bus, data, **step.arguments)
    except TypeError as error:
        raise ConfigError(f"check {step.check}: {error}") from None


def _bus(bus: Bus, _data: Path) -> str:
    started = time.monotonic()
    info = bus.call("INFO", "server").decode()
    elapsed_ms = (time.monotonic() - started) * 1e3
    fields = dict(line.split(":", 1) for line in info.splitlines() if ":" in line)
    version = fields.get("valkey_version") or fields.get("redis_version", "?")
    return f"{bus.address} answers in {elapsed_ms:.1f} ms (server {version})"


def _assets(_bus: Bus, _data: Path, *, files: list[str] | None = None) -> str:
    for reference in files or []:
        assets.resolve(reference)
    return f"{assets.root()}" if assets.root() else "none needed"


def _disk(_bus: Bus, data: Path, *, min_free_gb: float = 2.0) -> str:
    folder = next(p for p in [data.absolute(), *data.absolute().parents] if p.exists())
    free_gb = shutil.disk_usage(folder).free / _BYTES_PER_GB
    if free_gb < min_free_gb:
        raise NotReady(
            f"{folder}: {free_gb:.1f} GB free, {min_free_gb:g} needed; make room or record elsewhere with --data"
        )
    if not os.access(folder, os.W_OK):
        raise NotReady(f"{folder}: not writable; record elsewhere with --data")
    return f"{free_gb:.0f} GB free at {folder}"


def _clock(bus: Bus, _data: Path, *, max_skew_ms: float = 50.0) -> str:
    before_ns = time.time_ns()
    seconds, micros = (int(part) for part in bus.call("TIME"))
    after_ns = time.time_ns()
    skew_ms = (seconds * 1e9 + micros * 1e3 - (before_ns + after_ns) / 2) * 1e-6
    if abs(skew_ms) > max_skew_ms:
        raise NotReady(
            f"the bus's clock is {skew_ms:+.0f} ms from ours (limit {max_skew_ms:g}); synchronise both (NTP)"
        )
    return f"bus and station clocks {skew_ms:+.1f} ms apart"


def _ping(_bus: Bus, _data: Path, *, host: str) -> str:
    program = shutil.which("ping")
    if program is None:
        raise NotReady(f"{host}: there is no `ping` command to try it with; install iputils-ping")
    result = subprocess.run([program, "-c", "1", "-W", "2", "--", host], capture_output=True, text=True, check=False)
    if result.returncode:
        raise NotReady(f"{host} does not answer a ping; check cable, address and that the robot is on")
    return f"{host} answers"


def _interface(_bus: Bus, _data: Path, *, name: str) -> str:
    known = sorted(p.name for p in Path("/sys/class/net").glob("*"))
    if name not in known:
        raise NotReady(f"no network interface {name!r}; this machine has {', '.join(known)}")
    state = (Path("/sys/class/net") / name / "operstate").read_text().strip()
    if state == "down":
        raise NotReady(f"network interface {name} is down; plug it in or bring it up")
    return f"{name} is {state}"


def _key_rate(bus: Bus, _data: Path, *, key: str, min_hz: float, within_s: float = 2.0) -> str:
    count, newest = 0, None
    with bus.watch([key]) as watch:
        deadline = time.monotonic() + within_s
        while (remaining := deadline - time.monotonic()) > 0:
            sample = watch.wait(key, after=newest, timeout_s=remaining)
            if sample is not None:
                count, newest = count + 1, sample
    if count < min_hz * within_s:
        raise NotReady(f"{key}: {count / within_s:.1f} Hz, at least {min_hz:g} expected; is its writer running?")
    return f"{key} at {count / within_s:.0f} Hz"


_CHECKS: dict[CheckName, Callable[..., str]] = {
    "bus": _bus,
    "assets": _assets,
    "disk": _disk,
    "clock": _clock,
    "ping": _ping,
    "interface": _interface,
    "key-rate": _key_rate,
}
