"""Which keys and episodes go into a LeRobot data set, and that a dry run says the same as the run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from adapters.exports.kinds import CSV, JOINTSTATE_MCAP, LEROBOT
from adapters.exports.lerobot.kind import LeRobotOptions
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import hand
from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, contracts, keys
from station.contract import Contract
from station.export.kind import ExportKind, Source
from station.export.run import Exported, Workers, export, preview
from tests.episode.arm_run import ArmRun
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick
from tests.export.pictured import walked

HERE = Workers(jobs=1)
STATE, ACTION = keys.robot_state(ROBOT), keys.command_used(ROBOT)
FINGERS = [joint.removeprefix("left_") for joint in hand("left")]
HANDS = ("left hand", "right hand")
PARTS = {
    "left hand": (twist_keys.action_hand("left"), twist_keys.state_hand("left")),
    "right hand": (twist_keys.action_hand("right"), twist_keys.state_hand("right")),
    "neck": (twist_keys.action_neck(), twist_keys.state_neck()),
}


def grasped(
    data: Path, number: int = 1, *, moves: tuple[str, ...] = (), records: tuple[str, ...] = (*HANDS, "neck"),
    written_as: tuple[Contract, ...] = (),
) -> Source:  # fmt: skip
    """Record half a second: body still, parts as named; a part that moves opens by 1 rad, its state 0.1 rad behind."""
    builder = EpisodeBuilder(data, number=number)
    builder.contracts = {contract.key: contract for contract in written_as}
    for step in range(26):
        opened = step / 25
        for part in records:
            action, state = PARTS[part]
            contract = contracts.contract(action)
            assert contract is not None
            at = np.full(len(contract.elements), opened if part in moves else 0.0)
            behind = at - 0.1 if part in moves else at
            builder.write({action: codec.json_vector(at)}, at_s=0.1 + step / 50 - 0.004, writer="teleop")
            builder.write({state: codec.json_vector(behind)}, at_s=0.1 + step / 50)
        tick(builder, step, at_s=0.1 + step / 50)
    folder = builder.finish({"robot": {"suffix": ROBOT}})
    return Source(episode_id=folder.name, folder=str(folder))


def jogged(data: Path) -> Source:
    """Record an arm."""
    made = ArmRun(EpisodeBuilder(data, task="jog"))
    made.move(1.0)
    folder = made.finish()
    return Source(episode_id=folder.name, folder=str(folder))


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    return export(LEROBOT, sources, LeRobotOptions(min_quality="any", **options), out, where=HERE)


def test_hands_and_neck_that_move_are_in_the_data_set_in_a_fixed_order_and_gr00t_finds_them(tmp_path: Path) -> None:
    exported([grasped(tmp_path / "data", moves=("neck", *HANDS))], out := tmp_path / "set")
    features = json.loads((out / "meta/info.json").read_text())["features"]
    assert features["age_s.action"]["names"] == [
        ACTION, twist_keys.action_hand("left"), twist_keys.action_hand("right"), twist_keys.action_neck()
    ]  # fmt: skip
    assert features["age_s.observation.state"]["names"] == [
        STATE, twist_keys.state_hand("left"), twist_keys.state_hand("right"), twist_keys.state_neck()
    ]  # fmt: skip
    modality = json.loads((out / "meta/modality.json").read_text())
    for side, first in (("action", 35), ("state", 65)):
        assert modality[side]["left_hand"] == {"start": first, "end": first + 7}
        assert modality[side]["right_hand"] == {"start": first + 7, "end": first + 14}
        assert modality[side]["neck"] == {"start": first + 14, "end": first + 16}
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    action, state = np.array(rows["action"]), np.array(rows["observation.state"])
    assert action[:, 35:].max() > 0.9
    assert np.allclose(action[:, 35:] - state[:, 65:], 0.1, atol=1e-5)


def test_hands_that_never_move_are_not_in_the_data_set(tmp_path: Path) -> None:
    exported([grasped(tmp_path / "data", moves=("right hand",))], out := tmp_path / "set")
    features = json.loads((out / "meta/info.json").read_text())["features"]
    assert features["age_s.action"]["names"] == [ACTION, twist_keys.action_hand("right")]
    assert features["age_s.observation.state"]["names"] == [STATE, twist_keys.state_hand("right")]


def test_what_moves_only_in_later_episodes_is_told_of_by_name(tmp_path: Path) -> None:
    sources = [grasped(tmp_path / "data", 1), grasped(tmp_path / "data", 2, moves=("neck",))]
    (note,) = exported(sources, out := tmp_path / "set").facts["notes"]
    assert note.startswith("1 of 2 episodes (2026-11-21-g1-walk-0002 first) move what does not move in the first one")
    assert "not in the data set: neck; with --state KEYS --action KEYS they are" in note
    assert "parts that are not in the data set: neck" in (out / "README.md").read_text()
    told = preview(LEROBOT, sources, LeRobotOptions(min_quality="any"), where=HERE).notes
    assert told == ("2026-11-21-g1-walk-0002: parts, not in the data set: neck",)
    named = exported(sources, tmp_path / "named", state=(STATE,), action=(ACTION,))
    assert named.facts["notes"] == [], "who names the keys knows what is left out"


def test_an_episode_without_the_hands_of_the_first_one_is_refused_by_name(tmp_path: Path) -> None:
    sources = [grasped(tmp_path / "data", 1, moves=("left hand",)), grasped(tmp_path / "data", 2, records=())]
    found = exported(sources, tmp_path / "set")
    assert found.episodes == 1
    assert "walk-0002: no key 'state_hand_left_" in found.failed[0].reason


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"elements": [{"name": f"left_{name}_pos", "unit": "deg"} for name in FINGERS]},
            "has left_hand_thumb_0_pos in 'deg', the data set in 'rad'; export episodes of one unit at a time",
        ),
        ({"role": "sensor"}, "has role sensor in its contract, the data set command; export these episodes apart"),
        ({"rate_hz": 30.0}, "has rate_hz 30.0 in its contract, the data set 50.0; export these episodes apart"),
    ],
    ids=["unit", "role", "rate"],
)
def test_episodes_of_other_units_roles_or_rates_are_refused_by_name(
    tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    key = twist_keys.action_hand("left")
    changed = msgspec.convert({**msgspec.to_builtins(contracts.contract(key)), **change}, Contract)
    first = grasped(tmp_path / "data", 1, moves=("left hand",))
    second = grasped(tmp_path / "data", 2, moves=("left hand",), written_as=(changed,))
    found = exported([first, second], tmp_path / "set")
    assert [each.source for each in found.failed] == [second]
    assert found.failed[0].reason == f"{second.episode_id}: key '{key}' {told}"


def test_a_dry_run_refuses_what_the_run_refuses_for_the_same_reasons(tmp_path: Path) -> None:
    data = tmp_path / "data"
    good, blind, arm = walked(data, 1, seconds=0.6), walked(data, 2, seconds=0.6, camera_hz=0), jogged(data)
    short = walked(data, 3, seconds=0.0, camera_hz=0)
    sources = [good, blind, arm, short]
    seen = preview(LEROBOT, sources, LeRobotOptions(min_quality="any"), where=HERE)
    found = exported(sources, tmp_path / "set")
    assert seen.sources == (good,)
    reasons = {each.source: each.reason for each in seen.left_out}
    assert reasons == {each.source: each.reason for each in (*found.failed, *found.left_out)}
    assert "no camera 'head' in it" in reasons[blind]
    assert f"another robot ({KR810_ROBOT}) than the data set has ({ROBOT}); export it apart" in reasons[arm]


@pytest.mark.parametrize("kind", [CSV, JOINTSTATE_MCAP], ids=lambda kind: kind.name)
def test_a_dry_run_of_a_quick_look_refuses_what_the_run_refuses(tmp_path: Path, kind: ExportKind) -> None:
    sources = [grasped(tmp_path / "data", 1), grasped(tmp_path / "data", 2, records=())]
    options = kind.options(min_quality="any", keys=(twist_keys.state_hand("left"),))  # type: ignore[call-arg]
    seen = preview(kind, sources, options, where=HERE)
    assert seen.sources == (sources[0],)
    (found,) = export(kind, sources, options, tmp_path / "out", where=HERE).failed
    assert seen.left_out == (found,)
