"""``station export`` and ``station import`` as a user runs them."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from adapters.robots.g1 import twist_keys
from station.bus import keys
from tests.cli.at_terminal import AtTerminal, stands_still
from tests.cli.running import Home, new_home, one_line
from tests.episode.synthetic import EpisodeBuilder, walk
from tests.faults.disks import small_disk
from tests.foreign.recorded import STARTED_MS, document, record
from tests.waiting import wait_until


@pytest.fixture(scope="module")
def walked() -> Iterator[Home]:
    """A home with two good episodes, one that fell, and one that its recorder left open."""
    with new_home() as home:
        for number in (1, 2, 3, 4):
            builder = EpisodeBuilder(home.data, number=number)
            walk(builder, seconds=1.0)
            if number == 3:
                builder.event("fall", at_s=0.5, tilt_rad=1.2)
            builder.finish(torn=number == 4)
        yield home


@pytest.mark.usefixtures("processes")
def test_an_export_says_what_it_made_and_what_it_left_out_and_why(walked: Home, tmp_path: Path) -> None:
    out = tmp_path / "look"
    done = walked.run("export", "csv", "--out", str(out), "--min-quality", "usable")
    assert done.returncode == 1, "one could not be converted"
    failed, left_out = sorted(done.stderr.splitlines())
    assert failed.startswith("failed: 2026-11-21-g1-walk-0004: not finished")
    assert left_out.startswith("left out: 2026-11-21-g1-walk-0003: reject, and --min-quality asks for usable: 1 fall")
    assert done.stdout.startswith("csv: 2 episodes; 1 failed; 1 left out; ")
    assert done.stdout.endswith(f": {out}\n")
    assert sorted(path.name for path in out.iterdir()) == ["2026-11-21-g1-walk-0001", "2026-11-21-g1-walk-0002"]
    again = walked.run("export", "csv", "--out", str(out))
    assert one_line(again).startswith(f"{out}: is there already and not empty")


@pytest.mark.usefixtures("processes")
def test_what_is_only_left_out_is_no_failure_and_json_is_for_programs(walked: Home, tmp_path: Path) -> None:
    done = walked.run("export", "npz", "*-000[1-3]", "--min-quality", "usable", "--out", str(tmp_path / "x"), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["episodes"], len(found["left_out"]), found["failed"]) == (2, 1, [])
    assert found["files"] == len(list((tmp_path / "x").rglob("*.npz")))


@pytest.mark.usefixtures("processes")
def test_a_dry_run_names_episodes_and_columns_and_writes_nothing(walked: Home, tmp_path: Path) -> None:
    done = walked.run("export", "lerobot", "--dry-run", "--out", str(tmp_path / "set"))
    assert done.returncode == 0, done.stderr
    assert "goes in   2026-11-21-g1-walk-0001\n" in done.stdout
    assert "left out  2026-11-21-g1-walk-0003: reject" in done.stdout
    state = keys.robot_state(twist_keys.TWIST2_ROBOT)
    assert f"column    observation.state: {state}, 65 numbers: left_hip_pitch_pos [rad], " in done.stdout
    assert "column    age_s.observation.state, age_s.action: how old" in done.stdout
    assert done.stdout.endswith("2 of 4 episodes would go in; nothing was written\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("processes")
def test_formats_are_listed_and_their_options_explained(walked: Home) -> None:
    assert walked.run("export", "--list").stdout.splitlines()[0].startswith("csv ")
    told = " ".join(walked.run("export", "lerobot", "--help").stdout.split())
    assert "--min-quality [good|usable|any] Least verdict of `station check`. [default: usable]" in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["lerobt"], "unknown export format 'lerobt' (did you mean 'lerobot'?)"),
        (["csv"], "export csv: say which folder to make with --out"),
        (["lerobot", "--out", "x", "--fps", "0"], "export lerobot: fps: expected int >= 1"),
        (["csv", "nobody", "--out", "x"], "episode 'nobody': not found in"),
        (["csv", "--task", "run", "--out", "x"], "no episodes of task 'run' in"),
        (["csv", "--out", "x", "--keys", "nothing"], "no episode could be exported; "),
        (["csv", "--out", "x", "--ray", "nowhere"], "--ray 'nowhere': expected host:port"),
    ],
)
@pytest.mark.usefixtures("processes")
def test_what_cannot_be_is_told_in_a_line(walked: Home, tmp_path: Path, arguments: list[str], told: str) -> None:
    done = walked.run("export", *(str(tmp_path / word) if word == "x" else word for word in arguments))
    assert done.returncode in (1, 2)
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1].startswith(f"station: {told}")
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == [], "where nothing was made, nothing is left"


@pytest.mark.usefixtures("processes")
def test_episodes_are_added_to_a_finished_data_set_once_each_and_as_it_was_made(walked: Home, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert walked.run("export", "lerobot", "*-0001", "--out", str(out), "--fps", "25").returncode == 0
    again = walked.run("export", "lerobot", "*-0002", "--out", str(out))
    assert one_line(again).startswith(f"{out}: is there already and not empty; remove it, add to it with --append, or")
    other = walked.run("export", "lerobot", "*-0002", "--out", str(out), "--append", "--fps", "50")
    assert (other.returncode, one_line(other)) == (
        2, f"{out}: made with --fps 25, and --fps 50 is asked for; leave the option out, or export into another folder"
    )  # fmt: skip
    looked = walked.run("export", "lerobot", "*-000[12]", "--out", str(out), "--append", "--dry-run")
    assert looked.stdout.startswith("goes in   2026-11-21-g1-walk-0002\nin it     2026-11-21-g1-walk-0001\n")
    done = walked.run("export", "lerobot", "*-000[12]", "--out", str(out), "--append")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[0] == "in it already: 2026-11-21-g1-walk-0001"
    assert done.stdout.startswith("lerobot: 1 episode added to 1; 1 in it already; ")
    nothing = walked.run("export", "lerobot", "*-000[12]", "--out", str(out), "--append", "--json")
    found = json.loads(nothing.stdout)
    assert (nothing.returncode, found["episodes"], found["had"], len(found["there"])) == (0, 0, 2, 2)
    assert json.loads((out / "meta/info.json").read_text())["total_episodes"] == 2


@pytest.mark.usefixtures("processes")
def test_bags_of_several_episodes_are_made_side_by_side_and_read_by_rosbags(walked: Home, tmp_path: Path) -> None:
    out = tmp_path / "bags"
    tried = walked.run("export", "ros2", "*-000[12]", "--out", str(out), "--dry-run")
    assert tried.returncode == 0, tried.stderr
    assert tried.stdout.endswith("2 of 2 episodes would go in; nothing was written\n")
    done = walked.run("export", "ros2", "--out", str(out), "--min-quality", "usable", "--jobs", "2", "--json")
    assert done.returncode == 1, "one is not finished"
    found = json.loads(done.stdout)
    assert (found["episodes"], len(found["left_out"]), len(found["failed"])) == (2, 1, 1)
    bags = sorted(out.iterdir())
    assert [bag.name for bag in bags] == ["2026-11-21-g1-walk-0001", "2026-11-21-g1-walk-0002"]
    for bag in bags:
        with Reader(bag) as reader:
            counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/joint_states"] == counts["/joint_commands"] == counts["/tf"] == 50
    assert one_line(walked.run("export", "ros2", "--out", str(out))).startswith(f"{out}: is there already and not empt")
    wrong = walked.run("export", "ros2", "*-0001", "--out", str(tmp_path / "x"), "--keys", "robot_stat")
    assert "no key 'robot_stat' in it (did you mean" in one_line(wrong)
    assert not (tmp_path / "x").exists()


@pytest.mark.usefixtures("processes")
def test_without_rosbags_a_bag_is_refused_in_a_line_that_says_how_to_get_it(walked: Home, tmp_path: Path) -> None:
    code = "import runpy, sys; sys.modules['rosbags'] = None; runpy.run_module('station', run_name='__main__')"
    command = ("export", "ros2", "*-0001", "--out", str(tmp_path / "bags"))
    with AtTerminal(walked, *command, program=("-c", code)) as terminal:
        assert terminal.finish() == 1
    assert "pip install 'teleop-station[ros2]'" in " ".join(terminal.screen.split())
    assert list(tmp_path.iterdir()) == []


MANY = 50
HALF_WAY = """
import os, runpy, signal
from station import side_by_side
run = side_by_side.run
def run_half_way(*given, on_done, **how):
    done = []
    def tell(attempt):
        on_done(attempt)
        done.append(attempt)
        if len(done) == 5:
            os.kill(os.getpid(), signal.SIGSTOP)
    return run(*given, on_done=tell, **how)
side_by_side.run = run_half_way
runpy.run_module("station", run_name="__main__", alter_sys=True)
"""
"""The station, which stands still, and gives its processes no more to do, once five episodes are done."""


@pytest.fixture
def many(walked: Home, tmp_path: Path) -> Path:
    """A data folder with so many episodes that an export can be met in the middle."""
    (tmp_path / "data" / "walk").mkdir(parents=True)
    for number in range(MANY):
        (tmp_path / "data" / "walk" / f"{number:04d}").symlink_to(walked.data / "walk" / "2026-11-21-g1-walk-0001")
    return tmp_path / "data"


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_export_that_ends_in_the_middle_goes_on_when_it_is_called_again(
    walked: Home, many: Path, tmp_path: Path, number: signal.Signals
) -> None:
    command = ("export", "npz", "--data", str(many), "--out", str(tmp_path / "out"), "--jobs", "2")
    shards = tmp_path / ".out.export" / "shards"
    with AtTerminal(walked, *command, program=("-c", HALF_WAY)) as terminal:
        wait_until(lambda: stands_still(terminal.process.pid))
        assert len(list(shards.iterdir())) > 3
        os.killpg(terminal.process.pid, number)  # as Ctrl-C does
        terminal.send(signal.SIGCONT)
        code = terminal.finish()
        if number == signal.SIGINT:
            assert code == 130
            assert "of 50 episodes are converted and kept; the same command goes on from there" in terminal.screen
            assert "/50" in terminal.screen, "a bar moved"
    assert not (tmp_path / "out").exists(), "never half of it"
    done = walked.run(*command, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["episodes"] == MANY
    assert 3 < found["kept"] < MANY
    assert len(list((tmp_path / "out").iterdir())) == MANY
    assert not (tmp_path / ".out.export").exists()


@pytest.mark.usefixtures("processes")
def test_an_export_onto_a_full_disk_says_so_in_a_line_and_goes_on_when_there_is_room(
    walked: Home, many: Path, tmp_path: Path
) -> None:
    (tmp_path / "disk").mkdir()
    with small_disk(tmp_path / "disk", 64) as disk:
        (disk.path / "filler").write_bytes(bytes(127 << 19))
        command = ("export", "npz", "--data", str(many), "--out", str(disk.path / "out"), "--jobs", "2")
        told = one_line(walked.run(*command))
        assert re.search(
            r"\d{4}: .*: No space left on device; [1-9]\d* of 50 episodes are converted and kept beside .*/out: make",
            told,
        )
        assert not (disk.path / "out").exists()
        (disk.path / "filler").unlink()
        done = walked.run(*command, "--json")
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found["episodes"] == MANY
        assert found["kept"] > 0


def test_recordings_of_twist2_become_episodes_that_list_check_show_and_export(home: Home, tmp_path: Path) -> None:
    upstream = tmp_path / "upstream"
    for number in range(2):
        data = document(40, started_ms=STARTED_MS + 60_000 * number)
        record(upstream / "cabinet" / f"episode_{number:04d}", data)
    (upstream / "cabinet" / "episode_0002" / "rgb").mkdir(parents=True)
    done = home.run("import", "twist2", str(upstream), "--instruction", "open the cabinet")
    assert done.returncode == 1
    assert done.stderr.startswith(f"failed: {upstream}/cabinet/episode_0002/data.json: not there: TWIST2's recorder")
    assert done.stdout.splitlines()[-1].startswith("2 imported, 1 failed; ")
    shutil.rmtree(upstream / "cabinet" / "episode_0002")
    again = home.run("import", "twist2", str(upstream))
    assert (again.returncode, again.stdout.splitlines()[-1][:21]) == (0, "0 imported, 2 there a")
    rows = home.json("episodes", "list")
    assert {(row["task"], row["state"], row["operator"]) for row in rows} == {("cabinet", "finished", "ada")}
    checked = home.run("check", rows[0]["episode_id"])
    assert "recorded by TWIST2's recorder, which polled: what came between is lost" in checked.stdout
    assert (
        "jerky-command, velocity-scale, gyro-scale, position-jump, repeated-states: its recorder polled"
        in checked.stdout
    )
    command = ("export", "lerobot", "--task", "cabinet", "--out", str(tmp_path / "set"))
    stock = ("--state", twist_keys.state_body(twist_keys.TWIST2_ROBOT), "--action", twist_keys.action_body())
    assert f"name other keys, such as {' '.join(stock)}" in one_line(home.run(*command))
    assert "--fps 50 is more than its state has (30.3 Hz)" in home.run(*command, *stock).stderr
    assert home.run(*command, *stock, "--fps", "30", "--camera", "none").returncode == 0
    shown = home.run("episodes", "show", rows[0]["episode_id"]).stdout
    assert "whether the task succeeded; whether the robot fell" in shown
    exported = home.run("export", "csv", "--out", str(tmp_path / "look"))
    assert exported.returncode == 0, exported.stderr
    table = tmp_path / "look" / rows[0]["episode_id"] / f"{twist_keys.action_neck()}.csv"
    assert len(table.read_text().splitlines()) == 41


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["twist3", "."], "unknown format of recordings 'twist3' (did you mean 'twist2'?); known: twist2"),
        (["twist2", "nowhere"], "nowhere: no such folder"),
        (["twist2", "docs"], "docs: no recording of twist2 in it; expected TWIST2's recorder: episode_NNNN folders"),
    ],
)
def test_what_is_nothing_to_import_is_told_in_a_line(home: Home, arguments: list[str], told: str) -> None:
    assert one_line(home.run("import", *arguments)).startswith(told)
