"""Which rows of an episode a LeRobot data set has, and what each row and each episode says of itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from adapters.exports.kinds import CSV, LEROBOT
from adapters.exports.lerobot import about, named
from adapters.exports.lerobot.kind import LeRobotOptions
from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, keys
from station.control.gate import State
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.errors import EpisodeError
from station.export.kind import ExportOptions, Source
from station.export.run import Exported, Preview, Workers, export, preview
from tests.adapters.exports.lerobot.test_lerobot import pictures
from tests.episode.arm_run import ArmRun
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick
from tests.export.pictured import HEAD, pose, walked

HERE = Workers(jobs=1)
GATES: tuple[State, ...] = ("waiting",) * 20 + ("entering",) * 5 + ("tracking",) * 40 + ("holding",) * 5 + (
    "tracking",
) * 10 + ("returning",) * 15  # fmt: skip
START_NS = 1_795_000_000_000_000_000


def gated(
    data: Path, number: int = 1, *, gates: tuple[str, ...] = GATES, commanders: tuple[str, ...] = ("motion",),
    manifest: dict[str, Any] | None = None, moves: slice = slice(0, None), second_robot: bool = False,
) -> Source:  # fmt: skip
    """Record a step per state of the gate, 50 a second; joint 0 of step k is at k/100 while k is among `moves`."""
    builder = EpisodeBuilder(data, number=number)
    moving = set(range(len(gates))[moves])
    for step, gate in enumerate(gates):
        q = pose(0)
        q[0] = sum(other in moving for other in range(step)) / 100
        who = commanders[step * len(commanders) // len(gates)]
        tick(builder, step, at_s=0.1 + step / 50, q=q, gate=gate, commander=who)
    if second_robot:
        arm = ArmRun(builder)
        arm.move(1.0)
    folder = builder.finish({"robot": {"suffix": ROBOT}, **(manifest or {})})
    return Source(episode_id=folder.name, folder=str(folder))


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    return export(LEROBOT, sources, LeRobotOptions(**{"min_quality": "any", **options}), out, where=HERE)


def looked(sources: list[Source], **options: Any) -> Preview:
    return preview(LEROBOT, sources, LeRobotOptions(**{"min_quality": "any", **options}), where=HERE)


def rows_of(out: Path) -> dict[str, list[Any]]:
    table: dict[str, list[Any]] = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    return table


def steps_of(out: Path) -> list[int]:
    """The step of each row, by its time."""
    return [round(((time_ns - START_NS) * 1e-9 - 0.1) * 50 - 0.3) for time_ns in rows_of(out)["time_ns"]]


def named_gates(out: Path) -> list[str]:
    names = json.loads((out / "meta/names.json").read_text())["gate"]
    return [names[str(number)] for number in rows_of(out)["gate"]]


def test_the_gate_of_a_row_is_that_of_the_step_that_made_its_action(tmp_path: Path) -> None:
    exported([gated(tmp_path / "data")], out := tmp_path / "set", trim="none")
    steps = steps_of(out)
    assert len(steps) >= len(GATES) - 2
    assert named_gates(out) == [GATES[step] for step in steps]


def test_rows_are_by_default_from_the_first_entering_to_the_last_tracking(tmp_path: Path) -> None:
    source = gated(tmp_path / "data")
    (note,) = exported([source], out := tmp_path / "set").facts["notes"]
    assert steps_of(out) == list(range(20, 80))
    assert set(named_gates(out)) == {"entering", "tracking", "holding"}
    assert note.startswith("--trim waiting left out 0.")
    assert f"1 of 1 episodes: {source.episode_id} 0." in note
    assert looked([source]).notes == (
        f"{source.episode_id}: --trim waiting left out 0.4 s at its beginning, 0.3 s at its end",
    )
    (episode,) = json.loads((out / "meta/station.json").read_text())["episodes"]
    assert episode["trim"]["head_s"] == pytest.approx(0.4, abs=0.021)
    assert episode["trim"]["tail_s"] == pytest.approx(0.3, abs=0.021)
    card = (out / "README.md").read_text()
    assert "`--trim waiting`" in card
    assert "left out 0.4 s at its beginning" in card


def test_an_episode_whose_command_was_never_followed_is_left_out_by_name_and_kept_with_trim_none(
    tmp_path: Path,
) -> None:
    source = gated(tmp_path / "data", gates=("waiting",) * 40)
    with pytest.raises(EpisodeError, match=r"its gate tracked no command.*--trim none"):
        exported([source], tmp_path / "set")
    assert looked([source]).sources == ()
    beside = exported([source, gated(tmp_path / "data", 2)], tmp_path / "beside")
    assert (beside.episodes, [each.source for each in beside.left_out], beside.failed) == (1, [source], ())
    exported([source], out := tmp_path / "all", trim="none")
    assert set(named_gates(out)) == {"waiting"}


def test_trim_idle_keeps_what_check_finds_between_the_idle_ends(tmp_path: Path) -> None:
    source = gated(tmp_path / "data", gates=("tracking",) * 150, moves=slice(50, 100))
    exported([source], out := tmp_path / "set", trim="idle")
    (motion,) = check(open_episode(Path(source.folder))).motion
    assert 0.5 < motion.idle_head_s < 1.1
    times_s = (np.array(rows_of(out)["time_ns"]) - START_NS) * 1e-9
    begin_s, end_s = 0.1 + motion.idle_head_s, 0.1 + 149 / 50 - motion.idle_tail_s
    assert times_s[0] == pytest.approx(begin_s, abs=0.021)
    assert times_s[-1] == pytest.approx(end_s, abs=0.021)
    exported([source], whole := tmp_path / "whole")
    assert len(steps_of(whole)) > len(times_s) + 50


def test_an_episode_in_which_nothing_moves_is_refused_by_trim_idle(tmp_path: Path) -> None:
    source = gated(tmp_path / "data", gates=("tracking",) * 60, moves=slice(0, 0))
    with pytest.raises(EpisodeError, match="nothing moves in it"):
        exported([source], tmp_path / "set", trim="idle")


@pytest.mark.parametrize(
    ("marks", "first", "last"),
    [
        ([("start", 0.5), ("grasp", 0.7), ("stop", 1.1), ("later", 1.4)], 21, 49),
        ([("start", 0.5)], 21, 94),
        ([("reach", 0.5), ("grasp", 0.7), ("put", 1.1)], 21, 49),
    ],
    ids=["start and stop", "start alone", "other labels"],
)
def test_trim_marks_keeps_what_the_operator_marked(
    tmp_path: Path, marks: list[tuple[str, float]], first: int, last: int
) -> None:
    listed = [{"at_s": at_s, "label": label} for label, at_s in marks]
    exported([gated(tmp_path / "data", manifest={"marks": listed})], out := tmp_path / "set", trim="marks")
    steps = steps_of(out)
    assert abs(steps[0] - first) <= 1
    assert abs(steps[-1] - last) <= 1


def test_trim_marks_without_marks_keeps_everything_and_says_so(tmp_path: Path) -> None:
    source = gated(tmp_path / "data")
    (note,) = exported([source], out := tmp_path / "set", trim="marks").facts["notes"]
    assert note == f"--trim marks left nothing out of 1 of 1 episodes ({source.episode_id} first: it has no marks)"
    assert len(steps_of(out)) >= len(GATES) - 2


def test_an_arm_is_trimmed_by_its_own_gate(tmp_path: Path) -> None:
    made = ArmRun(EpisodeBuilder(tmp_path / "data", task="jog"))
    made.be_silent(0.6)
    made.move(1.0)
    folder = made.finish()
    exported([Source(episode_id=folder.name, folder=str(folder))], out := tmp_path / "set")
    assert set(named_gates(out)) <= {"entering", "tracking"}
    assert len(rows_of(out)["gate"]) < 1.1 * 50


def test_who_commands_is_told_row_by_row_with_one_numbering_for_all_episodes(tmp_path: Path) -> None:
    data = tmp_path / "data"
    sources = [gated(data, 1, commanders=("motion",)), gated(data, 2, commanders=("teleop", "motion"))]
    exported(sources, out := tmp_path / "set", trim="none")
    names = json.loads((out / "meta/names.json").read_text())["commander"]
    assert names == {"-1": named.NONE, "0": "motion walk.pkl", "1": "teleop walk.pkl"}
    rows, half = rows_of(out), len(GATES) // 2
    second = np.array(rows["commander"])[np.array(rows["episode_index"]) == 1]
    assert set(np.array(rows["commander"])[np.array(rows["episode_index"]) == 0]) == {0}
    assert second[: half - 2].tolist() == [1] * (half - 2)
    assert second[half + 2 :].tolist() == [0] * (len(second) - half - 2)
    found = json.loads((out / "meta/stats.json").read_text())["commander"]
    assert found["mean"][0] == pytest.approx(np.mean(rows["commander"]))
    assert "`commander`" in (out / "README.md").read_text()


def test_what_was_not_recorded_is_minus_one(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for step in range(30):
        builder.write({keys.robot_state(ROBOT): codec.f64(np.zeros(65)),
                       keys.command_used(ROBOT): codec.f64(np.zeros(35))}, at_s=step / 50)  # fmt: skip
    folder = builder.finish({"robot": {"suffix": ROBOT}})
    (note,) = exported([Source(episode_id=folder.name, folder=str(folder))], out := tmp_path / "set").facts["notes"]
    assert "nothing of its gate was recorded" in note
    assert set(rows_of(out)["gate"]) == set(rows_of(out)["commander"]) == {-1}


@pytest.mark.parametrize("layout", ["v3.0", "v2.1"])
def test_episodes_can_be_filtered_by_what_is_known_of_them_without_station_json(tmp_path: Path, layout: str) -> None:
    said = {
        "quality_flags": {"success": True},
        "operator": {"interface": "pico", "id": "ada"},
        "marks": [{"at_s": 0.5, "label": "grasp"}],
        "task": {"name": "walk", "instruction": "walk over there"},
    }
    sources = [gated(tmp_path / "data", 1, manifest=said), gated(tmp_path / "data", 2)]
    exported(sources, out := tmp_path / "set", layout=layout, min_quality="usable")
    if layout == "v3.0":
        table = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet")
        episodes = table.to_pylist()
        assert {name: str(table.schema.field(name).type) for name in about.FIELDS} == about.FIELDS
    else:
        episodes = [json.loads(line) for line in (out / "meta/episodes.jsonl").read_text().splitlines()]
    first, second = ({name: episode[name] for name in about.FIELDS} for episode in episodes)
    assert first | {"trim_head_s": 0, "trim_tail_s": 0} == {
        "episode_id": sources[0].episode_id, "task_name": "walk", "instruction": "walk over there", "success": "yes",
        "verdict": "usable", "operator": "ada", "interface": "pico", "policy": "", "recorded": "", "marks": 1,
        "trim_head_s": 0, "trim_tail_s": 0,
    }  # fmt: skip
    assert first["trim_head_s"] == pytest.approx(0.4, abs=0.021)
    assert (second["success"], second["operator"], second["marks"]) == ("", "", 0)
    assert set(about.FIELDS) == {name for names in about.MEANING for name in names.split(", ")} | {"episode_id"}


@pytest.mark.parametrize("layout", ["v3.0", "v2.1"])
def test_marks_are_subtasks_where_that_is_asked_for(tmp_path: Path, layout: str) -> None:
    marks = [{"at_s": at_s, "label": label} for label, at_s in (("start", 0.3), ("reach", 0.8), ("put", 1.2))]
    sources = [gated(tmp_path / "data", 1, manifest={"marks": marks}), gated(tmp_path / "data", 2)]
    exported(sources, out := tmp_path / "set", layout=layout, subtasks="marks", trim="none")
    if layout == "v3.0":
        table = pq.read_table(out / "meta/subtasks.parquet").to_pydict()
        texts = dict(zip(table["subtask_index"], table["subtask"], strict=True))
        rows = rows_of(out)
    else:
        lines = [json.loads(line) for line in (out / "meta/subtasks.jsonl").read_text().splitlines()]
        texts = {line["subtask_index"]: line["subtask"] for line in lines}
        tables = [pq.read_table(file).to_pydict() for file in sorted((out / "data").rglob("*.parquet"))]
        rows = {name: [value for table in tables for value in table[name]] for name in tables[0]}
    for time_ns, episode, number in zip(rows["time_ns"], rows["episode_index"], rows["subtask_index"], strict=True):
        at_s = (time_ns - START_NS) * 1e-9
        expected = "" if episode == 1 or at_s < 0.8 else "reach" if at_s < 1.2 else "put"
        assert texts[number] == expected
    assert sorted(texts) == [0, 1, 2]
    assert "subtask_index" in json.loads((out / "meta/info.json").read_text())["features"]


@pytest.mark.parametrize("kind", [LEROBOT, CSV], ids=lambda kind: kind.name)
def test_only_episodes_that_the_operator_called_a_success_go_in_on_request(tmp_path: Path, kind: Any) -> None:
    data = tmp_path / "data"
    yes = gated(data, 1, manifest={"quality_flags": {"success": True}})
    no = gated(data, 2, manifest={"quality_flags": {"success": False}})
    silent = gated(data, 3)
    options: ExportOptions = kind.options(min_quality="any", success="yes")
    found = export(kind, [yes, no, silent], options, tmp_path / "out", where=HERE)
    assert found.episodes == 1
    assert [each.reason for each in found.left_out] == [
        f"{no.episode_id}: the operator called it a failure, and --success asks for yes",
        f"{silent.episode_id}: the operator called it neither a success nor a failure, and --success asks for yes",
    ]
    seen = preview(kind, [yes, no, silent], options, where=HERE)
    assert (seen.sources, set(seen.left_out)) == ((yes,), set(found.left_out))
    failures = export(
        kind, [yes, no, silent], kind.options(min_quality="any", success="no"), tmp_path / "no", where=HERE
    )
    assert failures.episodes == 1


def test_a_shard_of_another_success_is_not_taken_for_this_one(tmp_path: Path) -> None:
    from station.export import shards

    source = gated(tmp_path / "data", manifest={"quality_flags": {"success": True}})
    plan = LEROBOT.prepare([source], LeRobotOptions(min_quality="any"))
    found = []
    with shards.open_work(tmp_path / "set") as work:
        for success in ("any", "any", "no"):
            task = shards.Task(
                format="lerobot", source=source, plan=plan, min_quality="any", success=success, work=str(work)
            )  # fmt: skip
            found.append(shards.make_shard(task).status)
    assert found == ["made", "kept", "left-out"]


def test_the_newest_picture_is_never_of_after_the_tick(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=1.0)
    exported([source], newest := tmp_path / "newest", pictures="newest")
    exported([source], nearest := tmp_path / "nearest")
    ages = np.array(rows_of(newest)["age_s.camera.head"])
    assert 0.0 <= ages.min() < ages.max() < 1 / 30 + 1e-6
    assert np.array(rows_of(nearest)["age_s.camera.head"]).min() < 0.0
    taken_s = (np.array(rows_of(newest)["time_ns"]) - START_NS) * 1e-9 - ages
    shown = pictures(newest / "videos/observation.images.head/chunk-000/file-000.mp4")
    assert shown == np.round((taken_s - 0.083) * 30).astype(int).tolist()
    assert "the newest picture taken at or before the tick" in (newest / "README.md").read_text()
    assert looked([source], pictures="newest").plan.pictures == "newest"


@pytest.mark.parametrize(
    ("stated", "options", "fps", "follows"),
    [
        ({HEAD: 15}, {}, 15, "camera head, the slowest"),
        ({HEAD: 120}, {}, 50, "the state, slower than any camera"),
        ({}, {}, 50, "no camera that states its rate"),
        ({HEAD: 15}, {"fps": 25}, 25, "--fps"),
        ({HEAD: 15}, {"camera": ("none",)}, 50, "no camera that states its rate"),
    ],
    ids=["camera", "fast camera", "unknown", "asked for", "no camera"],
)
def test_rows_come_as_often_as_pictures_of_the_slowest_camera_unless_told_otherwise(
    tmp_path: Path, stated: dict[str, float], options: dict[str, Any], fps: int, follows: str
) -> None:
    servers = {f"camera{number}": {"key": key, "fps": hz} for number, (key, hz) in enumerate(stated.items())}
    source = walked(tmp_path / "data", seconds=1.0, manifest={"servers": servers})
    assert LEROBOT.columns is not None
    seen = looked([source], **options)
    assert f"rows: {fps} per second, as {follows}" in "\n".join(LEROBOT.columns(seen.plan))
    exported([source], out := tmp_path / "set", **options)
    assert json.loads((out / "meta/info.json").read_text())["fps"] == fps
    assert f"rate: {fps} Hz, as {follows}" in (out / "README.md").read_text()


def test_an_episode_of_several_robots_is_refused_by_name_and_goes_in_with_robot(tmp_path: Path) -> None:
    both = gated(tmp_path / "data", second_robot=True)
    with pytest.raises(EpisodeError, match=rf"several robots.*--robot {KR810_ROBOT} or --robot {ROBOT}"):
        exported([both], tmp_path / "set")
    for robot, width in ((ROBOT, 35), (KR810_ROBOT, 7)):
        exported([both], out := tmp_path / robot, robot=robot)
        assert json.loads((out / "meta/info.json").read_text())["features"]["action"]["shape"] == [width]
    with pytest.raises(EpisodeError, match=rf"another robot than kassow_kr81.*it has {ROBOT}"):
        exported([gated(tmp_path / "data", 2)], tmp_path / "none", robot="kassow_kr81")


def test_episodes_of_another_robot_are_refused_by_name(tmp_path: Path) -> None:
    made = ArmRun(EpisodeBuilder(tmp_path / "data", task="jog"))
    made.move(1.0)
    arm = Source(episode_id=(folder := made.finish()).name, folder=str(folder))
    found = exported([gated(tmp_path / "data", 1), arm], tmp_path / "set")
    (lost,) = found.failed
    assert lost.reason == (
        f"{arm.episode_id}: another robot ({KR810_ROBOT}) than the data set has ({ROBOT}); "
        f"export it apart, with --robot {KR810_ROBOT}"
    )


def test_options_are_part_of_what_a_shard_is(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.5)
    plans = [
        LEROBOT.prepare([source], LeRobotOptions(min_quality="any", **options))
        for options in ({}, {"gop": 2}, {"trim": "none"}, {"pictures": "newest"}, {"fps": 25}, {"subtasks": "marks"})
    ]
    assert len({msgspec.json.encode(plan) for plan in plans}) == len(plans)
