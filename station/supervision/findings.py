"""What a doctor finds, and what is to be found on this machine itself: upstream data, versions, scheduling."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from importlib import metadata
from typing import Literal

import msgspec

from station import assets, packages, registry
from station.bus.client import Bus
from station.bus.protection import REMEDY, look

_PACKAGES = (packages.DISTRIBUTION, "mujoco", "onnxruntime", "numpy", "redis", "mcap", "rerun-sdk")


class Finding(msgspec.Struct, frozen=True):
    """One thing that was looked at.

    Attributes:
        level: ``ok``, ``warning`` (works, but look) or ``broken``.
        subject: What was looked at.
        found: What was found.
        remedy: What to do; empty when nothing.
    """

    level: Literal["ok", "warning", "broken"]
    subject: str
    found: str
    remedy: str = ""


def bus_access(bus: Bus) -> Finding:
    """Look at who can reach a bus."""
    protection = look(bus)
    level: Literal["ok", "warning", "broken"] = (
        "ok" if protection.verdict == "closed" else "broken" if protection.verdict == "open" else "warning"
    )
    return Finding(level, "bus access", protection.found, "" if level == "ok" else REMEDY)


def hidden_packages() -> list[Finding]:
    """Look whether packages of others hide ours; without ours nothing can be found by its name."""
    return [Finding("broken", f"package {name}", found.found, found.remedy)
            for name in packages.IMPORTED if (found := packages.hiding(name)) is not None]  # fmt: skip


def machine() -> Iterator[Finding]:
    """Look at this machine: upstream data, packages, versions, scheduling."""
    if outdated := registry.outdated():
        yield Finding("broken", "installation", outdated, f"install it again: {registry.INSTALL}")
    base = assets.root()
    if base is None:
        yield Finding("ok", "assets", f"built in; ${assets.ENVIRONMENT_VARIABLE} is not set, cache {assets.cache()}")
    elif not base.is_dir():
        yield Finding("broken", "assets", f"{base} is not a folder", f"mend ${assets.ENVIRONMENT_VARIABLE}")
    else:
        yield Finding("ok", "assets", str(base))
    for name in packages.IMPORTED:
        if (shared := packages.sharing(name)) is not None:
            yield Finding("warning", f"package {name}", shared.found, shared.remedy)
    missing = [name for name in _PACKAGES if _version(name) is None]
    versions = ", ".join(f"{name} {_version(name) or 'MISSING'}" for name in _PACKAGES)
    yield Finding("broken" if missing else "ok", "versions", f"python {platform.python_version()}, {versions}",
                  f"pip install {' '.join(missing)}" if missing else "")  # fmt: skip
    yield _scheduling()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _scheduling() -> Finding:
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except (PermissionError, AttributeError):
        return Finding("warning", "scheduling", "real-time scheduling is not permitted",
                       "for a steady loop on a busy machine grant rtprio in /etc/security/limits.conf")  # fmt: skip
    return Finding("ok", "scheduling", "real-time scheduling is permitted")
