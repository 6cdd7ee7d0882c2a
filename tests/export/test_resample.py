"""Rows on one clock: which value stands in which row, and how old it is."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import contracts, keys
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.errors import EpisodeError
from station.export import tracks
from station.export.columns import KeyColumns, expect_same, key_columns, unique_names
from station.export.resample import Table, nearest, resample, rule_of, ticks_at
from tests.episode.synthetic import ROBOT, EpisodeBuilder
from tests.export.pictured import HEAD, walked

STATE, ACTION = keys.robot_state(ROBOT), keys.command_used(ROBOT)


def table_of(folder: str, *, fps: int = 50, action: str = ACTION, cameras: tuple[str, ...] = ()) -> Table:
    reader = EpisodeReader(signals_file(Path(folder)))
    state, asked = key_columns(reader, STATE), key_columns(reader, action)
    recorded = tracks.read(reader, [state, asked], cameras)
    return resample(recorded, [state], [asked], fps, "it")


@pytest.mark.parametrize("jitter_s", [0.0, 0.001])
@pytest.mark.parametrize("fps", [50, 25, 10])
def test_the_action_of_a_row_is_what_the_step_made_of_its_state(tmp_path: Path, fps: int, jitter_s: float) -> None:
    table = table_of(walked(tmp_path, camera_hz=0, jitter_s=jitter_s).folder, fps=fps)
    steps = np.round(table.state[STATE].values[:, 0] * 1000)
    asked = np.round(table.action[ACTION].values[:, 6] * 1000) - 500
    assert len(steps) > 1.8 * fps
    assert (steps == asked).all()
    assert table.without_own_step == 0


def test_jitter_of_the_writers_neither_repeats_nor_skips_a_step(tmp_path: Path) -> None:
    table = table_of(walked(tmp_path, camera_hz=0, jitter_s=0.002).folder)
    steps = np.round(table.state[STATE].values[:, 0] * 1000).astype(int)
    assert (np.diff(steps) == 1).mean() > 0.97
    assert (table.state[STATE].ages_s >= 0).all()


def test_a_command_as_it_was_sent_is_the_newest_at_the_tick(tmp_path: Path) -> None:
    table = table_of(walked(tmp_path, camera_hz=0).folder, action=twist_keys.action_body())
    assert (table.action[twist_keys.action_body()].ages_s >= 0).all()
    assert (table.action[twist_keys.action_body()].ages_s < 0.021).all()


def test_the_picture_of_a_row_is_the_nearest_by_capture_not_by_arrival(tmp_path: Path) -> None:
    table = table_of(walked(tmp_path).folder, cameras=(HEAD,))
    assert np.abs(table.pictures[HEAD].ages_s).max() <= 1 / 60 + 1e-6
    assert (np.diff(table.pictures[HEAD].numbers) >= 0).all()


def test_ticks_are_exactly_apart_however_long_they_go_on() -> None:
    ticks = ticks_at(7, 3_600_000_000_007, 30, np.array([0]))
    assert len(ticks) == 108_001
    assert ticks[-1] == 3_600_000_000_007


def test_a_picture_that_runs_backwards_is_never_chosen() -> None:
    times: Ints = np.array([0, 10, 5, 20, 20, 30])
    found = nearest(times, np.array([-5, 4, 6, 12, 21, 99]))
    assert found.tolist() == [0, 0, 1, 1, 3, 5]


def without_action(tmp_path: Path, lost: int, *, second_from: int = 10_000) -> tuple[Table, Ints]:
    """Lose the action of one step; a second process runs from another step on. Return rows, and each row's lag."""
    source = walked(tmp_path, camera_hz=0)
    reader = EpisodeReader(signals_file(Path(source.folder)))
    columns = [key_columns(reader, STATE), key_columns(reader, ACTION)]
    recorded = tracks.read(reader, columns, ())
    for key in (STATE, ACTION):
        track = recorded.tracks[key]
        numbers = np.arange(len(track.times_ns))
        kept = (numbers != lost) | (key == STATE)
        writers = np.where(numbers < second_from, 0, 1)
        recorded.tracks[key] = tracks.Track(track.times_ns[kept], track.values[kept], writers[kept], 0)
    table = resample(recorded, columns[:1], columns[1:], 50, "it")
    lag = np.round(table.action[ACTION].values[:, 6] * 1000 - 500 - table.state[STATE].values[:, 0] * 1000)
    return table, lag.astype(np.int64)


def test_a_step_whose_action_was_lost_is_counted(tmp_path: Path) -> None:
    table, lag = without_action(tmp_path, 40)
    assert (table.without_own_step, np.flatnonzero(lag).tolist(), lag.max()) == (1, [40], 1)


def test_the_last_step_of_a_process_that_died_before_its_action_is_counted(tmp_path: Path) -> None:
    table, lag = without_action(tmp_path, 40, second_from=41)
    assert (table.without_own_step, np.flatnonzero(lag).tolist(), lag.min()) == (1, [40], -1)


def test_a_rate_above_the_state_is_refused_with_the_rate_that_would_do(tmp_path: Path) -> None:
    with pytest.raises(EpisodeError, match=r"--fps 100 is more than its state has \(50 Hz\).*ask for 50 or less"):
        table_of(walked(tmp_path, camera_hz=0).folder, fps=100)


def test_a_key_without_a_contract_is_refused_with_what_to_do(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.foreign("my_force", b"[1.0, 2.0]", at_s=0.1)
    builder.write({keys.policy_obs(ROBOT): bytes(32)}, at_s=0.1)
    reader = EpisodeReader(signals_file(builder.finish()))
    with pytest.raises(EpisodeError, match=r"'my_force' has no contract.*the server that writes it can describe it"):
        key_columns(reader, "my_force")
    with pytest.raises(EpisodeError, match="names no elements"):
        key_columns(reader, keys.policy_obs(ROBOT))
    with pytest.raises(EpisodeError, match=r"no key 'my_farce'.*did you mean 'my_force'"):
        key_columns(reader, "my_farce")


def test_an_episode_whose_elements_have_other_names_or_another_order_is_refused(tmp_path: Path) -> None:
    reader = EpisodeReader(signals_file(Path(walked(tmp_path, camera_hz=0).folder)))
    own = key_columns(reader, STATE)
    expect_same(reader, [own])
    for names, odd in (((*own.names[:-1], "tail_pos"), "tail_pos"), (own.names[::-1], "in another order")):
        with pytest.raises(EpisodeError, match=f"{odd}.*one robot at a time"):
            expect_same(reader, [msgspec.structs.replace(own, names=names)])


def test_names_are_the_contracts_and_get_the_key_only_where_two_agree() -> None:
    def columns(key: str) -> KeyColumns:
        found = contracts.contract(key)
        assert found is not None
        units = tuple(item.unit for item in found.elements)
        return KeyColumns(key=key, role=found.role, codec="f64", names=found.names, units=units)

    names = unique_names([columns(STATE), columns(keys.sim_qpos(ROBOT))])
    assert len(set(names)) == len(names)
    assert "gyro_x" in names
    assert f"{keys.sim_qpos(ROBOT)}.left_knee_pos" in names
    assert rule_of(columns(ACTION), as_action=True) == "step"
    assert rule_of(columns(ACTION), as_action=False) == "newest"


def test_values_that_do_not_fit_are_left_out_and_counted(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number, value in enumerate((b"[1.0]", b"oops", b"[" + b"0.5, " * 34 + b"0.5]")):
        builder.foreign(twist_keys.action_body(), value, at_s=0.1 * number)
    reader = EpisodeReader(signals_file(builder.finish()))
    track = tracks.read(reader, [key_columns(reader, twist_keys.action_body())], ()).tracks[twist_keys.action_body()]
    assert (len(track.times_ns), track.skipped) == (1, 2)
