"""Episodes that were never closed: found by their files alone, read as far as they tell, and offered for repair."""

from __future__ import annotations

import contextlib
from pathlib import Path

from station.atomic_file import remove_leftovers
from station.clock import SYSTEM
from station.episode.storage import layout
from station.episode.storage.folder import is_numbered, started_ns
from station.episode.storage.records import MAGIC
from station.lock_file import is_locked

_SMALL = (layout.RESUME, layout.CHECKPOINT)
_JUST_NOW_S = 10.0
_TEMPORARY = tuple(f".{name}." for name in (layout.MANIFEST, *_SMALL))


def left_open(data: Path) -> list[Path]:
    """Return the folders of the episodes that were never closed and are not written any more, oldest first.

    One without signals is not among them: there is nothing to repair, and perhaps its recorder lives and waits for the
    disk.
    """
    found = (folder for folder in data.glob("*/*/") if has_signals(folder) and is_left_open(folder))
    return sorted(found, key=started_ns)


def to_repair(data: Path) -> tuple[list[Path], list[Path]]:
    """Return the folders of the episodes that were left open or have a file that is cut off, oldest first; and those
    whose file lacks its end because it may still be copied: it changed a moment ago."""
    cut_off = [folder for folder in data.glob("*/*/") if _is_cut_off(folder)]
    changing = [folder for folder in cut_off if any(map(_changed_just_now, _finished(folder)))]
    found = {*left_open(data), *cut_off}.difference(changing)
    return sorted(found, key=lambda folder: (started_ns(folder), folder.name)), changing


def is_left_open(folder: Path) -> bool:
    """Whether an episode was never closed, and its writer is dead."""
    active = folder / layout.ACTIVE
    if active.exists():
        return not is_locked(active)
    return (folder / layout.RESUME).exists() and not is_locked(folder / layout.SIGNALS)


def _is_cut_off(folder: Path) -> bool:
    """Whether a file that was finished lacks its end now."""
    return any(not is_locked(file) and not _has_end(file) for file in _finished(folder))


def _finished(folder: Path) -> list[Path]:
    return [file for names in layout.ALL_NAMES if (file := folder / names.final).is_file()]


def _changed_just_now(file: Path) -> bool:
    return abs(SYSTEM.wall_ns() - file.stat().st_mtime_ns) < _JUST_NOW_S * 1e9


def _has_end(file: Path) -> bool:
    with file.open("rb") as opened:
        opened.seek(max(0, file.stat().st_size - len(MAGIC)))
        return opened.read() == MAGIC


def has_signals(folder: Path) -> bool:
    """Whether there is a file of signals, finished or not."""
    return (folder / layout.ACTIVE).exists() or (folder / layout.SIGNALS).exists()


def not_begun(data: Path) -> list[Path]:
    """Return the folders of episodes of which there is no more than where their start stands on the bus.

    Only the holder of the data folder's claim knows that none of them is just being begun.
    """
    return [folder for folder in data.glob("*/*/") if is_numbered(folder) and not any(map(_is_of_it, folder.iterdir()))]


def remove_temporary(folder: Path) -> None:
    """Remove the temporary files that a killed recorder left in the folder of an episode."""
    remove_leftovers(*(folder / name for name in (layout.MANIFEST, *_SMALL)))


def remove_not_begun(folder: Path) -> None:
    """Remove such a folder; one in which somebody put something else stays."""
    remove_temporary(folder)
    for name in _SMALL:
        (folder / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def offer(data: Path) -> str | None:
    """Return a line that says how to repair what a dead recorder left behind; None where nothing was."""
    found = left_open(data)
    if not found:
        return None
    what = f"episode {found[0].name} was" if len(found) == 1 else f"{len(found)} episodes, {found[0].name} first, were"
    return f"{what} left open by a recorder that died; repair with: station episodes repair --all --data {data}"


def _is_of_it(file: Path) -> bool:
    """Whether a file says that an episode has begun, or is not ours."""
    return file.name not in _SMALL and not file.name.startswith(_TEMPORARY)
