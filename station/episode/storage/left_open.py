"""Episodes that nobody closed: found by their files alone, read as far as they tell, and offered for repair."""

from __future__ import annotations

from pathlib import Path

from station.episode.storage import layout
from station.episode.storage.disk import is_locked
from station.episode.storage.folder import started_ns


def left_open(data: Path) -> list[Path]:
    """Return the folders of the episodes that nobody closed and nobody writes any more, oldest first."""
    return sorted((folder for folder in data.glob("*/*/") if is_left_open(folder)), key=started_ns)


def is_left_open(folder: Path) -> bool:
    """Whether an episode was never closed, and whoever wrote it is dead."""
    active = folder / layout.ACTIVE
    if active.exists():
        return not is_locked(active)
    return (folder / layout.RESUME).exists() and not is_locked(folder / layout.SIGNALS)


def has_signals(folder: Path) -> bool:
    """Whether there is a file of signals, finished or not."""
    return (folder / layout.ACTIVE).exists() or (folder / layout.SIGNALS).exists()


def offer(data: Path) -> str | None:
    """Return a line that says how to repair what a dead recorder left behind; None where nothing was."""
    found = left_open(data)
    if not found:
        return None
    what = f"episode {found[0].name} was" if len(found) == 1 else f"{len(found)} episodes, {found[0].name} first, were"
    return f"{what} left open by a recorder that died; repair with: station episodes repair --all --data {data}"
