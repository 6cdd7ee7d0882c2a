from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

from adapters.exports.kinds import PARQUET
from adapters.exports.named_rows import QuickLookOptions
from adapters.exports.parquet_tables import CONTENTS, EPISODES, EVENTS, FIRST_COLUMNS, column_names, folder_name
from station.bus import codec, contracts, keys
from station.contract import Contract
from station.episode.reading.reader import open_episode
from station.export.columns import KeyColumns
from station.export.kind import Source
from station.export.run import Exported, Workers, export
from tests.enrich.recordings import FALL_S, walked
from tests.episode.synthetic import ROBOT, WALL_START_NS, EpisodeBuilder, walk

STATE = keys.robot_state(ROBOT)
INSTANT = pa.timestamp("ns", "UTC")


def exported(episodes: list[Path], out: Path, *only: str) -> Exported:
    sources = [Source(episode_id=folder.name, folder=str(folder)) for folder in episodes]
    return export(PARQUET, sources, QuickLookOptions(keys=only), out, where=Workers(jobs=1))


def contract_of(key: str) -> Contract:
    found = contracts.contract(key)
    assert found is not None
    return found


def numbers(table: Any) -> Any:
    """The elements of a table, shape (k, m)."""
    return np.stack([table.column(name).to_numpy() for name in table.column_names[len(FIRST_COLUMNS) :]], axis=1)


def test_each_key_is_a_table_of_the_recorded_numbers_bit_for_bit_under_names_with_units(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data")
    made = exported([episode], out := tmp_path / "out")
    reader = open_episode(episode)
    count = 0
    for key in (STATE, keys.command_used(ROBOT), keys.operator_head("pico")):
        table = pq.read_table(out / key / f"{episode.name}.parquet")
        recorded, described = reader.vectors(key), contract_of(key)
        assert table.column_names == [*FIRST_COLUMNS, *described.names]
        assert numbers(table).tobytes() == recorded.values.tobytes()
        assert table.column("log_time").type == table.column("publish_time").type == INSTANT
        assert table.column("log_time").cast(pa.int64()).to_pylist() == recorded.log_ns.tolist()
        assert table.column("publish_time").cast(pa.int64()).to_pylist() == recorded.publish_ns.tolist()
        assert np.allclose(table.column("log_time_s"), (recorded.log_ns - WALL_START_NS) * 1e-9, atol=1e-9)
        assert np.allclose(table.column("publish_time_s"), (recorded.publish_ns - WALL_START_NS) * 1e-9, atol=1e-9)
        kept = [message for message in reader.messages([key]) if not message.channel.is_deletion]
        assert table.column("sequence").to_pylist() == [message.sequence for message in kept]
        assert table.column("writer").to_pylist() == [message.channel.writer for message in kept]
        assert set(table.column("episode").to_pylist()) == {episode.name}
        units = [(table.schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in described.names]
        assert units == [element.unit for element in described.elements]
        of_the_file = json.loads(table.schema.metadata[b"station"])
        assert of_the_file["columns"] == {element.name: element.unit for element in described.elements}
        assert (of_the_file["key"], of_the_file["start_ns"], of_the_file["note"]) == (
            key,
            WALL_START_NS,
            described.note,
        )
        count += len(kept)
    assert made.rows >= count > 100


def test_numbers_keep_the_type_that_their_contract_says(tmp_path: Path) -> None:
    builder, key = EpisodeBuilder(tmp_path / "data"), keys.policy_obs(ROBOT)
    described = {**msgspec.to_builtins(contract_of(key)), "elements": [{"name": f"x{n}", "unit": ""} for n in range(3)]}
    builder.contracts = {key: msgspec.convert(described, Contract)}
    values = np.array([0.1, np.nan, 1e-42], dtype=np.float32)
    builder.write({key: codec.f32(values)}, at_s=0.1)
    episode = builder.finish()
    exported([episode], out := tmp_path / "out")
    table = pq.read_table(out / key / f"{episode.name}.parquet")
    assert [table.schema.field(name).type for name in ("x0", "x1", "x2")] == [pa.float32()] * 3
    assert numbers(table).tobytes() == open_episode(episode).vectors(key).values.tobytes() == values.tobytes()


def test_more_rows_than_a_block_come_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.exports.parquet_tables._ROWS", 7)
    episode = walked(tmp_path / "data")
    exported([episode], out := tmp_path / "out", STATE)
    file = pq.ParquetFile(out / STATE / f"{episode.name}.parquet")
    assert [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)] == [7] * 7 + [1]
    assert numbers(file.read()).tobytes() == open_episode(episode).vectors(STATE).values.tobytes()


def test_the_folder_of_a_key_is_one_table_of_all_episodes_for_pandas_and_polars(tmp_path: Path) -> None:
    episodes = [walked(tmp_path / "data", number=number) for number in (1, 2)]
    exported(episodes, out := tmp_path / "out")
    recorded = np.concatenate([open_episode(episode).vectors(STATE).values for episode in episodes])
    names = list(contract_of(STATE).names)
    assert numbers(ds.dataset(out / STATE).to_table()).tobytes() == recorded.tobytes()
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    frame = pandas.read_parquet(out / STATE)
    assert np.ascontiguousarray(frame[names].to_numpy()).tobytes() == recorded.tobytes()
    assert str(frame["log_time"].dtype) == "datetime64[ns, UTC]"
    assert frame["episode"].unique().tolist() == [episode.name for episode in episodes]
    polar = polars.read_parquet(out / STATE / "*.parquet")
    assert np.ascontiguousarray(polar.select(names).to_numpy()).tobytes() == recorded.tobytes()
    assert polar["log_time"].dtype == polars.Datetime("ns", "UTC")


def test_events_and_marks_are_a_table_and_episodes_too(tmp_path: Path) -> None:
    first = walked(tmp_path / "data", number=1)
    builder = EpisodeBuilder(tmp_path / "data", number=2)
    walk(builder, seconds=0.5)
    builder.write({keys.EVENT: b"[1]"}, at_s=0.4)
    second = builder.finish(
        {
            "robot": {"suffix": ROBOT},
            "operator": {"id": "kim"},
            "timing": {"duration_s": 0.6},
            "marks": [{"at_s": 0.25, "label": "grasped"}],
            "quality_flags": {"success": True},
        }
    )
    exported([first, second], out := tmp_path / "out")
    events = pq.read_table(out / EVENTS)
    assert events.schema.field("log_time").type == INSTANT
    fall, mark = events.to_pylist()
    assert (fall["episode"], fall["kind"], fall["name"], fall["severity"], fall["source"]) == (
        first.name, "event", "fall", "error", "g1"
    )  # fmt: skip
    assert json.loads(fall["detail"]) == {"lean_rad": 1.25}
    assert fall["log_time_s"] == pytest.approx(FALL_S, abs=0.01)
    assert (mark["episode"], mark["kind"], mark["name"], mark["log_time_s"]) == (second.name, "mark", "grasped", 0.25)
    one, two = pq.read_table(out / EPISODES).to_pylist()
    assert (one["episode"], one["success"], one["start_time"].value) == (first.name, None, WALL_START_NS)
    assert (two["task"], two["operator"], two["robot"], two["duration_s"], two["success"]) == (
        "walk", "kim", ROBOT, 0.6, True
    )  # fmt: skip
    contents = json.loads((out / CONTENTS).read_text())
    assert [each["events_unfit"] for each in contents["episodes"]] == [0, 1]
    assert contents["episodes"][0]["left_out"] == sorted(contents["episodes"][0]["left_out"])
    assert "strange" in contents["episodes"][0]["left_out"]
    assert {table["folder"] for table in contents["tables"].values()} == {
        path.name for path in out.iterdir() if path.is_dir()
    }


def test_a_key_in_another_unit_is_told_of_by_name(tmp_path: Path) -> None:
    folders = []
    for number, unit in ((1, "rad"), (2, "deg")):
        builder = EpisodeBuilder(tmp_path / "data", number=number)
        described = msgspec.to_builtins(contract_of(STATE))
        described["elements"][0]["unit"] = unit
        builder.contracts = {STATE: msgspec.convert(described, Contract)}
        builder.write({STATE: codec.f64([0.0] * 65)}, at_s=0.1)
        folders.append(builder.finish())
    (note,) = exported(folders, tmp_path / "out").facts["notes"]
    assert note.startswith(f"{STATE}: {folders[1].name} has other columns or units than {folders[0].name}; ")


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data", seconds=0.2)
    for place in ("one", "two"):
        exported([episode], tmp_path / place)
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert len(files) > 5
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file


def test_folders_differ_whatever_the_keys_are_and_hold_nothing_that_a_reader_skips() -> None:
    some = ["a/b", "a:b", "a.b", "a%2Fb", "..", ".x", "events.parquet", "é", "x" * 300, "x" * 301]
    names = [folder_name(key) for key in some]
    assert len(set(names)) == len(some)
    assert all("/" not in name and not name.startswith(".") and len(name.encode()) < 255 for name in names)
    assert EVENTS not in names
    assert folder_name(STATE) == STATE


def test_columns_differ_whatever_the_elements_are_called() -> None:
    columns = KeyColumns(key="k", role="state", codec="f64", names=("x", "writer", "x", "x"), units=("",) * 4)
    assert column_names(columns) == ["x", "k.writer", "k.x", "k.3.x"]
