"""A recorded episode for notebooks and scripts: its streams as arrays and frames, steps, pictures, clouds."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station import depth as depths
from station import point_cloud
from station.api import streams as found
from station.api.steps import Steps, names_and_units, read_steps
from station.api.streams import Holds, Stream
from station.api.table import Record, Records, Table
from station.bus import keys
from station.episode.reading import frames, reader
from station.episode.reading.messages import Channel, Ints
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import robots_of
from station.episode.reading.vectors import numbers
from station.episode.storage.manifest import Manifest
from station.errors import EpisodeError, UnknownName
from station.printable import printable
from station.protocols import Floats, Floats32

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

    from station.episode.quality.findings import Quality

_NANOSECONDS = 1e-9


def open_episode(episode: str | Path = "latest", data: str | Path | None = None) -> Episode:
    """Open a recorded episode.

    Args:
        episode: ``latest``, an id or its unique beginning, ``task/id``, or the path of a folder or an MCAP file.
        data: Folder of episodes in which ids are looked up; None takes ``$STATION_DATA``, else ``./data``.

    Raises:
        EpisodeError: not found, ambiguous, or no episode; one line that says what is there.
    """
    folder = None if data is None else Path(data).expanduser()
    return Episode(reader.open_episode(Path(episode).expanduser(), folder))


class Episode:
    """A recorded episode. Values are read from its files when they are asked for.

    Times are seconds from the start of the episode, by the clock of the recorder; `wall_ns` and `mono_ns` turn them
    into times of the wall clock and of the recorder's monotonic clock. Recorded values that do not fit what their key
    holds are left out: a Python warning tells how many, and so does ``skipped`` of a `Table` or of `Records`.

    Args:
        source: What reads its files.
    """

    def __init__(self, source: EpisodeReader) -> None:
        self._reader = source

    @property
    def id(self) -> str:
        """Name of the episode, unique in its data folder."""
        return self._reader.episode_id or self.folder.name

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        return self._reader.folder

    @property
    def manifest(self) -> Manifest:
        """What was recorded, by whom, with what: task, operator, policy, servers, events, quality."""
        return self._reader.manifest

    @property
    def torn(self) -> str | None:
        """One line that says what its files lack, or that they were never finished; None for whole files."""
        return self._reader.torn

    @property
    def verdict(self) -> str:
        """What the last `station check` wrote: ``good``, ``usable`` or ``reject``; "" before one."""
        return str(self.manifest.quality.get("verdict", ""))

    def check(self) -> Quality:
        """Measure it from its files and judge it by this user's rules; the manifest stays as it is.

        Policy and gate run again too, as in `station check`: of an episode that is short, and whose policy is here.

        ``verdict`` and ``reasons`` of what comes are what `station check` prints first.
        """
        from station.episode.quality.check import check
        from station.episode.quality.rule_file import of_user
        from station.episode.replaying.in_short import LONGEST_S, audit_in_short

        return check(self._reader, of_user(), audit=audit_in_short(self._reader, longest_s=LONGEST_S))

    @property
    def duration_s(self) -> float:
        """Length from start to stop [s]; of torn or unfinished files, from the start to the last message."""
        recorded = self.manifest.timing.duration_s
        if self.torn is None and recorded is not None:
            return recorded
        last_ns = max((stream.last_ns for stream in self._reader.streams()), default=self._reader.start_ns)
        return (last_ns - self._reader.start_ns) * _NANOSECONDS

    @cached_property
    def robots(self) -> list[str]:
        """Names of its robots, which end their keys: ``robot_state_<name>``."""
        named = [self.manifest.robot.suffix] if self.manifest.robot.suffix else []
        return sorted({*robots_of(self._reader), *named})

    @property
    def keys(self) -> list[str]:
        """Every key that has values."""
        return sorted(self._channels)

    @cached_property
    def cameras(self) -> list[str]:
        """Names of its cameras."""
        return list(frames.cameras(self._reader))

    @cached_property
    def depth_cameras(self) -> list[str]:
        """Names of its cameras whose depth was recorded."""
        return list(frames.depths(self._reader))

    @cached_property
    def lidars(self) -> list[str]:
        """Names of its lidars."""
        return list(frames.lidars(self._reader))

    @cached_property
    def streams(self) -> list[Stream]:
        """What each key holds, its names, units, rates and counts, by key and writer; `pandas.DataFrame` takes it."""
        return found.read_streams(self._reader)

    def numpy(self, key: str, *columns: str) -> Table:
        """Return the numbers of a key: values (n, m) float64 with names and units, and a time per row.

        Args:
            key: The key; where it fits but one, a pattern (``"robot_state_*"``) or the beginning of its name
                (``"robot_state"``) will do, here and wherever a key is named.
            columns: Names of columns, or patterns such as ``"*_pos"``; none for all columns.

        Raises:
            UnknownName: the episode has no such key, or the key no such column; says which there are.
            EpisodeError: the key holds no numbers, or its file is damaged.
        """
        key = self._key(key)
        held = self._holds(key)
        if held != "numbers":
            self._refuse(key, held)
        messages = self._reader.collect([key])[key]
        contract = next((message.channel.contract for message in messages if message.channel.contract), None)
        vectors, skipped = numbers(key, messages)
        if skipped:
            _warn(f"{key}: {skipped} of {skipped + len(vectors.values)} values do not fit its contract; left out")
        width = vectors.values.shape[1]
        names, units = ((), ()) if contract is None else names_and_units(contract, width)
        values = np.asarray(vectors.values, dtype=np.float64)
        table = Table(
            key, self._seconds(vectors.log_ns), self._seconds(vectors.publish_ns), values, names, units, skipped
        )
        return table.select(*columns) if columns else table

    def pandas(self, key: str, *columns: str) -> pd.DataFrame:
        """Return the values of a key as a pandas frame: index ``time_s`` [s], a column per number or JSON member.

        ``frame.attrs["units"]`` holds the units by column.

        Args:
            key: The key.
            columns: Of numbers: names of columns, or patterns such as ``"*_pos"``; none for all columns.

        Raises:
            StationError: pandas is not installed, or as `numpy` and `json`.
        """
        return self._table(key, columns).pandas()

    def polars(self, key: str, *columns: str) -> pl.DataFrame:
        """Return the values of a key as a polars frame: column ``time_s`` [s], a column per number or JSON member.

        Args:
            key: The key.
            columns: Of numbers: names of columns, or patterns such as ``"*_pos"``; none for all columns.

        Raises:
            StationError: polars is not installed, or as `numpy` and `json`.
        """
        return self._table(key, columns).polars()

    def json(self, key: str) -> Records:
        """Return the JSON values of a key, each with its time.

        Raises:
            UnknownName: the episode has no such key.
            EpisodeError: its file is damaged.
        """
        return self._json(self._key(key))

    def events(self) -> Records:
        """Return every event of the station in order of arrival: ``value`` has name, severity, source and detail."""
        return self._json(keys.EVENT)

    def raw(self, key: str) -> Iterator[tuple[float, bytes]]:
        """Iterate over the values of a key as they were written: time [s] and the exact bytes.

        Raises:
            UnknownName: the episode has no such key.
            EpisodeError: its file is damaged.
        """
        for message in self._reader.messages([self._key(key)]):
            if not message.channel.is_deletion:
                yield (message.log_ns - self._reader.start_ns) * _NANOSECONDS, message.data

    def steps(self, robot: str | None = None) -> Steps:
        """Return the policy steps of a robot as arrays: command as used, state, observation, action, target, timing.

        Args:
            robot: One of `robots`; None for the only one that has policy steps.

        Raises:
            UnknownName: no such robot has policy steps, others have.
            EpisodeError: no robot has policy steps, or several have and none is named; or its file is damaged.
        """
        steps = read_steps(self._reader, robot)
        for table in steps.parts().values():
            if table.skipped:
                _warn(f"{table.key}: {table.skipped} values do not fit its contract; their steps hold NaN")
        return steps

    def pictures(self, camera: str | None = None) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Iterate over the pictures of a camera: time of capture [s], and RGB, shape (height, width, 3), uint8.

        One picture is in memory at a time. A picture that cannot be decoded is left out, with a warning.

        Args:
            camera: One of `cameras`; None for the only one.

        Raises:
            UnknownName: there is no such camera.
            EpisodeError: none is named, and there is none or there are several; or its file is damaged.
        """
        for time_s, jpeg in self.jpegs(camera):
            rgb = _decoded(jpeg)
            if rgb is None:
                _warn(f"camera {camera or self.cameras[0]}: the picture of {time_s:.3f} s cannot be decoded; left out")
            else:
                yield time_s, rgb

    def depth(self, camera: str | None = None) -> Iterator[tuple[float, Floats32]]:
        """Iterate over the depth of a camera: time of capture [s], and metres, shape (height, width), float32.

        Depth is measured along the optical axis, and is 0 where nothing was measured. It is recorded in whole steps, of
        a millimetre each; `raw` gives the PNG files as they are. A picture that cannot be decoded is left out, with a
        warning.

        Args:
            camera: One of `depth_cameras`; None for the only one.

        Raises:
            UnknownName: there is no such camera, or it has no depth.
            EpisodeError: none is named, and there is none or there are several; or its file is damaged.
        """
        name, topic = self._chosen("camera with depth", frames.depths(self._reader), camera)
        step_m = frames.step_m(self._reader, topic)
        for time_s, data in self._files(topic):
            steps = depths.decoded(data)
            if steps is None:
                _warn(f"camera {name}: the depth of {time_s:.3f} s cannot be decoded; left out")
            else:
                yield time_s, depths.in_metres(steps, step_m)

    def jpegs(self, camera: str | None = None) -> Iterator[tuple[float, bytes]]:
        """Iterate over the pictures of a camera as recorded: time of capture [s], and the bytes of the JPEG file.

        Of an episode that was compacted the files are made of its video.

        Args:
            camera: One of `cameras`; None for the only one.

        Raises:
            UnknownName: there is no such camera.
            EpisodeError: none is named, and there is none or there are several; or its file is damaged.
        """
        _, topic = self._chosen("camera", frames.cameras(self._reader), camera)
        yield from self._files(topic)

    def clouds(
        self, lidar: str | None = None, *, most: int = point_cloud.MOST_POINTS, seed: int = 0
    ) -> Iterator[tuple[float, Floats32]]:
        """Iterate over the clouds of a lidar: time of capture [s], and points [m], shape (n, 3), float32, all finite.

        They are in the frame that the lidar is mounted in, else in its own; points without a return are left out, and
        so is, with a warning, what is no cloud. `raw` and `station.point_cloud` give every field of every point.

        Args:
            lidar: One of `lidars`; None for the only one.
            most: Of more points a random choice stays.
            seed: Of that choice.

        Raises:
            UnknownName: there is no such lidar.
            EpisodeError: none is named, and there is none or there are several; or its file is damaged.
        """
        name, topic = self._chosen("lidar", frames.lidars(self._reader), lidar)
        for time_s, data in self._files(topic):
            try:
                cloud = point_cloud.decoded(data)
            except point_cloud.BadCloud as error:
                _warn(f"lidar {name}: the cloud of {time_s:.3f} s is none: {error}; left out")
            else:
                yield time_s, point_cloud.xyz(cloud, most=most, seed=seed)

    def wall_ns(self, time_s: ArrayLike) -> Ints:
        """Return times of the episode on the wall clock [ns since the Unix epoch]; shape as given.

        The wall clock is read once, at the start of an episode, so a step of it bends no times.

        Args:
            time_s: Times from the start of the episode [s]: of a table, a step, a picture, the index of a frame.
        """
        return np.rint(np.asarray(time_s, dtype=np.float64) / _NANOSECONDS).astype(np.int64) + self._reader.start_ns

    def mono_ns(self, time_s: ArrayLike) -> Ints:
        """Return times of the episode on the monotonic clock of the machine that recorded it [ns]; shape as given.

        Args:
            time_s: Times from the start of the episode [s].

        Raises:
            EpisodeError: the episode does not say how its clocks lie.
        """
        anchor = self._reader.anchor
        if anchor is None:
            raise EpisodeError(f"{self.id}: its file does not say what the monotonic clock was")
        return self.wall_ns(time_s) - anchor.wall_ns + anchor.mono_ns

    def __repr__(self) -> str:
        head = (
            f"episode {self.id}: task {self.manifest.task.name}, {self.duration_s:.1f} s, "
            f"{self.verdict or 'unchecked'}, {', '.join(self.robots) or 'no robot'}"
        )
        torn = [] if self.torn is None else [f"  torn: {self.torn}"]
        return "\n".join(printable(line) for line in [head, *torn, *found.lines(self.streams)])

    def _chosen(self, what: str, by_name: Mapping[str, str], wanted: str | None) -> tuple[str, str]:
        """Return name and key of the camera or lidar that is meant."""
        if wanted is None and len(by_name) != 1:
            which = f"{what.split(maxsplit=1)[0]}s {' and '.join(by_name)}; name one" if by_name else f"no {what} in it"
            raise EpisodeError(f"{self.id}: {which}")
        name = next(iter(by_name)) if wanted is None else wanted
        if name not in by_name:
            raise UnknownName(f"{what} of {self.id}", name, by_name)
        return name, by_name[name]

    def _files(self, topic: str) -> Iterator[tuple[float, bytes]]:
        for frame in frames.frames(self._reader, topic):
            yield (frame.captured_ns - self._reader.start_ns) * _NANOSECONDS, frame.data

    @cached_property
    def _channels(self) -> dict[str, list[Channel]]:
        """Channels with values by key."""
        by_key: dict[str, list[Channel]] = {}
        for channel in found.values_of(self._reader):
            by_key.setdefault(channel.topic, []).append(channel)
        return by_key

    def _key(self, key: str) -> str:
        """Return the key that is meant: by its name, by a pattern, or by its beginning, without the robot's name."""
        if key in self._channels:
            return key
        fitting = [name for name in self.keys if fnmatchcase(name, key) or name.startswith(f"{key}_")]
        if len(fitting) > 1:
            raise EpisodeError(f"{self.id}: {key!r} fits {len(fitting)} keys, {', '.join(fitting)}; name one")
        if not fitting:
            raise UnknownName(f"key of {self.id}", key, self._channels)
        return fitting[0]

    def _holds(self, key: str) -> Holds:
        return found.holds(self._channels[key])

    def _refuse(self, key: str, held: Holds) -> NoReturn:
        """Refuse a key that holds no numbers; the error says how its values are read."""
        names = {topic: name for name, topic in frames.cameras(self._reader).items()}
        depth_of = {topic: name for name, topic in frames.depths(self._reader).items()}
        pictures = f"depth({depth_of[key]!r})" if key in depth_of else f"pictures({names.get(key)!r})"
        lidar_of = {topic: name for name, topic in frames.lidars(self._reader).items()}
        clouds = f"clouds({lidar_of.get(key)!r})"
        how = {"pictures": pictures, "clouds": clouds, "json": f"json({key!r})"}.get(held, f"raw({key!r})")
        has_contract = any(channel.contract is not None for channel in self._channels[key])
        why = f"holds {held}, no numbers" if has_contract else "has no contract, so nothing says what its numbers are"
        raise EpisodeError(f"{self.id}: key {key!r} {why}; episode.{how} reads it")

    def _table(self, key: str, columns: Sequence[str]) -> Table | Records:
        key = self._key(key)
        return self._json(key) if self._holds(key) == "json" and not columns else self.numpy(key, *columns)

    def _json(self, key: str) -> Records:
        start_ns = self._reader.start_ns
        records = Records(Record((log_ns - start_ns) * _NANOSECONDS, value) for log_ns, value in self._reader.json(key))
        records.skipped = self._reader.skipped[key]
        if records.skipped:
            _warn(f"{key}: {records.skipped} of {records.skipped + len(records)} values are no JSON; left out")
        return records

    def _seconds(self, times_ns: Ints) -> Floats:
        return np.asarray((times_ns - self._reader.start_ns) * _NANOSECONDS, dtype=np.float64)


def _decoded(jpeg: bytes) -> NDArray[np.uint8] | None:
    """Return a picture as RGB, shape (height, width, 3), or None for bytes that are none."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(jpeg), formats=("JPEG",)) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # what Pillow says of broken bytes
        return None


def _warn(text: str) -> None:
    warnings.warn(printable(text), stacklevel=3)
