"""What stands beside unfinished files for whoever goes on with them: how far they are safe, what is known of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from station.clock import SYSTEM, Clock
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.progress import ResumePoint, save_resume_point
from station.episode.writing.checkpoint import EVERY_S, save_checkpoints

if TYPE_CHECKING:
    from station.bus.tap import Position
    from station.episode.writing.files import EpisodeFiles


class Ledger:
    """Keeps the two small files of one episode up to date.

    Args:
        folder: Folder of the episode.
        episode_id, anchor, start_id: As in `ResumePoint`.
        clock: The recorder's.
    """

    def __init__(self, folder: Path, episode_id: str, anchor: Anchor, start_id: str, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._folder = folder
        self._episode_id = episode_id
        self._anchor = anchor
        self._start_id = start_id
        self._due = self._clock.monotonic_s() + EVERY_S

    def note(self, position: Position | None, files: EpisodeFiles | None) -> None:
        """Say how far the files are safe, right after a flush; None for files that are not there yet.

        Raises:
            OSError: the disk refused it.
        """
        point = ResumePoint(
            episode_id=self._episode_id,
            position=position,
            size=files.signals.size if files else 0,
            cameras_size=files.cameras.size if files and files.cameras else 0,
            messages=files.messages if files else 0,
            anchor=self._anchor,
            wall_ns=self._clock.wall_ns(),
            mono_ns=self._clock.monotonic_ns(),
            dropped=files.drops.total if files else 0,
            drops=list(files.drops) if files else [],
            start_id=self._start_id,
        )
        save_resume_point(point, self._folder)
        now = self._clock.monotonic_s()
        if files is not None and now >= self._due:
            self._due = now + EVERY_S
            save_checkpoints(files.checkpoints(), self._folder)

    def remove(self) -> None:
        """Remove both: the episode is closed."""
        for name in (layout.RESUME, layout.CHECKPOINT):
            (self._folder / name).unlink(missing_ok=True)
