"""Automatic checks of a runbook: each is a type with its arguments, and says what it found or what to do."""

from __future__ import annotations

import os
import shutil
import subprocess
import threading
from pathlib import Path
from typing import Protocol

import msgspec

from station import assets
from station.bus.client import Bus
from station.bus.protection import REMEDY, inspect
from station.episode.storage.bin import bin_folder
from station.errors import NotReady
from station.life.server import read_health
from station.supervision.disk_need import SIGNALS_MB_PER_MINUTE, DiskNeed

_BYTES_PER_GB = 1e9
_LOOK_S = 0.1  # a request to stop is seen after so long
_CLOCK_LOOKS = 5  # the quickest answer tells most


class Check(Protocol):
    """One check with its arguments."""

    def run(self, bus: Bus, data: Path, stop: threading.Event) -> str:
        """Return what was found, in a few words.

        Args:
            bus: The station's.
            data: Folder of episodes.
            stop: Set when somebody asks the station to stop: what waits ends.

        Raises:
            StationError: the check failed; the message says what to do.
        """
        ...


class BusCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The server answers, and strangers cannot reach it.

    Attributes:
        allow_open: Whether it may be open to the network without a password: on a cable that nobody else is on.
    """

    allow_open: bool = False

    def run(self, bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Ask it who it is."""
        started = bus.clock.monotonic_s()
        info = bus.call("INFO", "server").decode()
        elapsed_ms = (bus.clock.monotonic_s() - started) * 1e3
        fields = dict(line.split(":", 1) for line in info.splitlines() if ":" in line)
        version = fields.get("valkey_version") or fields.get("redis_version", "?")
        found = f"{bus.address} answers in {elapsed_ms:.1f} ms (server {version})"
        protection = inspect(bus)
        if protection.verdict == "open" and not self.allow_open:
            raise NotReady(f"bus {bus.address}: {protection.found}; {REMEDY}")
        return found if protection.verdict == "closed" else f"{found}, {protection.found}"


class AssetsCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Upstream files are there; `files` are references."""

    files: list[str]

    def run(self, _bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Find each."""
        for reference in self.files:
            assets.resolve(reference)
        return f"{len(self.files)} files found"


def existing(folder: Path) -> Path:
    """Return a folder, or the next one above it that is there."""
    return next(path for path in [folder.absolute(), *folder.absolute().parents] if path.exists())


def free_gb(folder: Path) -> float:
    """Return what is free where a folder is, or will be made [GB]."""
    return shutil.disk_usage(existing(folder)).free / _BYTES_PER_GB


class DiskCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """There is room for episodes.

    Attributes:
        min_free_gb: Least free space [GB].
        min_minutes: Least time that must fit [min].
        mb_per_minute: What an episode is taken to need [MB/min]; None for what the last episode of the task with the
            same cameras needed, else for an estimate by the cameras that will run.
    """

    min_free_gb: float = 2.0
    min_minutes: float = 0.0
    mb_per_minute: float | None = None

    def __post_init__(self) -> None:
        """Refuse a rate that fills no disk."""
        if self.mb_per_minute is not None and not self.mb_per_minute > 0:
            raise ValueError(f"mb_per_minute is {self.mb_per_minute}, expected more than 0")

    def run(self, _bus: Bus, data: Path, _stop: threading.Event) -> str:
        """Check the data folder, or where it will be made."""
        return self.look(data, DiskNeed(SIGNALS_MB_PER_MINUTE, ""))

    def look(self, data: Path, need: DiskNeed) -> str:
        """Do so with what an episode is expected to need, where the runbook does not say."""
        folder = existing(data)
        empty = "empty the bin (station episodes prune --empty-bin), " if bin_folder(data).is_dir() else ""
        found = self.judge(free_gb(data), str(folder), need, empty)
        if not folder.is_dir() or not os.access(folder, os.W_OK):
            raise NotReady(f"{folder}: not a folder that can be written; record elsewhere with --data")
        return found

    def judge(self, free_gb: float, folder: str, need: DiskNeed, empty: str = "") -> str:
        """Judge what is free, on whatever machine.

        Args:
            free_gb: That [GB].
            folder: Where.
            need: As of `look`.
            empty: What would make room, before all else.

        Raises:
            NotReady: it is too little.
        """
        if self.mb_per_minute is not None:
            need = DiskNeed(self.mb_per_minute, "")
        rate = f"{need.mb_per_minute:.3g} MB/min" + (f" ({need.why})" if need.why else "")
        if free_gb < self.min_free_gb:
            raise NotReady(
                f"{folder}: {free_gb:.1f} GB free, {self.min_free_gb:g} needed; "
                f"{empty}make room or record elsewhere with --data"
            )
        minutes = free_gb * 1e3 / need.mb_per_minute
        if minutes < self.min_minutes:
            raise NotReady(
                f"{folder}: {free_gb:.1f} GB free are {minutes:.0f} min at {rate}, "
                f"{self.min_minutes:g} needed; {empty}make room or record elsewhere with --data"
            )
        return f"{free_gb:.0f} GB free at {folder}, {minutes:.0f} min at {rate}"


class ClockCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bus host's wall clock agrees with ours."""

    max_skew_ms: float = 50.0

    def run(self, bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Compare them."""
        skew_ms = min(_skew(bus) for _ in range(_CLOCK_LOOKS))[1]
        if abs(skew_ms) > self.max_skew_ms:
            raise NotReady(
                f"the bus's clock is {skew_ms:+.0f} ms from ours (limit {self.max_skew_ms:g}); synchronise both (NTP)"
            )
        return f"bus and station clocks {skew_ms:+.1f} ms apart"


class PingCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A host answers."""

    host: str

    def run(self, _bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Ping it once."""
        program = shutil.which("ping")
        if program is None:
            raise NotReady(f"{self.host}: there is no `ping` command to try it with; install iputils-ping")
        arguments = [program, "-c", "1", "-W", "2", "--", self.host]
        if subprocess.run(arguments, capture_output=True, check=False).returncode:
            raise NotReady(f"{self.host} does not answer a ping; check cable, address and that the robot is on")
        return f"{self.host} answers"


class InterfaceCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A network interface exists and is up."""

    name: str

    def run(self, _bus: Bus, _data: Path, _stop: threading.Event) -> str:
        """Look at what the kernel says of it."""
        known = sorted(p.name for p in Path("/sys/class/net").glob("*"))
        if self.name not in known:
            raise NotReady(f"no network interface {self.name!r}; this machine has {', '.join(known)}")
        state = (Path("/sys/class/net") / self.name / "operstate").read_text().strip()
        if state == "down":
            raise NotReady(f"network interface {self.name} is down; plug it in or bring it up")
        return f"{self.name} is {state}"


class KeyRateCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Somebody writes a key often enough; `within_s` is how long it is counted [s]."""

    key: str
    min_hz: float
    within_s: float = 2.0

    def run(self, bus: Bus, _data: Path, stop: threading.Event) -> str:
        """Count its writes for a while."""
        count, newest = 0, None
        with bus.watch([self.key]) as watch:
            deadline = bus.clock.monotonic_s() + self.within_s
            while (remaining := deadline - bus.clock.monotonic_s()) > 0:
                if stop.is_set():
                    raise NotReady(f"asked to stop while writes of {self.key} were counted")
                sample = watch.wait(self.key, after=newest, timeout_s=min(remaining, _LOOK_S))
                if sample is not None:
                    count, newest = count + 1, sample
        rate_hz = count / self.within_s
        if rate_hz < self.min_hz:
            raise NotReady(f"{self.key}: {rate_hz:.1f} Hz, at least {self.min_hz:g} expected; is its writer running?")
        return f"{self.key} at {rate_hz:.0f} Hz"


class RobotReadyCheck(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot that checks itself finds nothing against being armed, within so long [s]; nothing is moved."""

    server: str
    within_s: float = 10.0

    def run(self, bus: Bus, _data: Path, stop: threading.Event) -> str:
        """Read its server's heartbeat until nothing is against it."""
        deadline = bus.clock.monotonic_s() + self.within_s
        while True:
            health = next((one for one in read_health(bus) if one.name == self.server), None)
            if health is None:
                raise NotReady(f"no server {self.server!r} runs on {bus.address}")
            why_not = health.detail.get("why_not_arm")
            if why_not is None:
                raise NotReady(f"{self.server}: its robot does not check itself; this check is for real robots")
            if not why_not:
                return f"{self.server} finds nothing against arming"
            if stop.is_set() or bus.clock.monotonic_s() > deadline:
                raise NotReady(f"{self.server}: {why_not}")
            bus.clock.wait(stop, _LOOK_S)


KINDS: dict[str, type[msgspec.Struct]] = {
    "bus": BusCheck,
    "assets": AssetsCheck,
    "disk": DiskCheck,
    "clock": ClockCheck,
    "ping": PingCheck,
    "interface": InterfaceCheck,
    "key-rate": KeyRateCheck,
    "robot-ready": RobotReadyCheck,
}
"""Types of checks by the name that a runbook uses."""


def _skew(bus: Bus) -> tuple[float, float]:
    """Return how long the question took, and how far the bus's clock is ahead of ours [ms]."""
    before_ns = bus.clock.wall_ns()
    seconds, micros = (int(part) for part in bus.call("TIME"))
    after_ns = bus.clock.wall_ns()
    middle_ns = (before_ns + after_ns) / 2
    return (after_ns - before_ns) * 1e-6, (seconds * 1e9 + micros * 1e3 - middle_ns) * 1e-6
