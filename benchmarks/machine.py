"""Where and with what a table was measured."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path

from station.bus.redis_server import find_binary
from station.errors import BusError
from station.software import software

_PACKAGES = ("redis", "hiredis", "numpy", "mujoco", "onnxruntime", "mcap", "msgspec")


def describe() -> list[str]:
    """Return facts of the machine, one a line; nothing that names it or its owner."""
    code = software()
    versions = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    return [
        f"{os.cpu_count()} x {_processor()}, {_memory_gb():.0f} GB, Linux {platform.release()}",
        f"CPython {platform.python_version()}, {_server()}, {versions}",
        f"teleop-station {code.version}",
    ]


def today() -> str:
    """Return the date."""
    return datetime.datetime.now(tz=datetime.UTC).date().isoformat()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _memory_gb() -> float:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


def _server() -> str:
    try:
        answer = subprocess.run([find_binary(), "--version"], capture_output=True, text=True, check=True, timeout=5.0)
    except (BusError, OSError, subprocess.SubprocessError):
        return "unknown server"
    words = answer.stdout.replace(",", " ").split()  # "Valkey server v=8.1.8 sha=…"
    return " ".join(word for word in words[:3] if word != "server")


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "absent"
