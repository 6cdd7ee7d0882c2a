"""``station rehearse``: patterns of clips, and the suite that judges a policy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.adapters.policies.velocity_inputs import onnx_file
from tests.cli.running import Home, are_gone, one_line
from tests.suite.made import limp_network
from tests.waiting import wait_until

TRACKER = ("--policy", "tracker", "--checkpoint", "builtin:tracker.onnx", "--robot-model", "builtin:g1.xml")
QUICK = ("rehearse", "--suite", "--quick", "--physics-dt", "0.002", *TRACKER)


@pytest.fixture
def bare(home: Home) -> Home:
    """A place without upstream data."""
    return home.without("STATION_ASSETS")


@pytest.fixture
def limp(tmp_path: Path) -> str:
    return str(limp_network(tmp_path / "limp.onnx"))


def test_a_pattern_names_built_in_clips(bare: Home) -> None:
    done = bare.run("rehearse", "builtin:reach-*", *TRACKER, "--physics-dt", "0.002", "--json", "--jobs", "2")
    assert done.returncode == 0, done.stderr
    clips = ["builtin:reach-both", "builtin:reach-left", "builtin:reach-right"]
    assert [motion["motion"] for motion in json.loads(done.stdout)["motions"]] == clips


def test_settings_are_those_of_the_robots_server(bare: Home) -> None:
    sets = ("--set", "policy_options.wrist_gains=real", "--set", "robot_options.latency_steps=1")
    asked = ("rehearse", "builtin:wave", *TRACKER, "--physics-dt", "0.002", "--json", "--jobs", "1")
    plain, changed = (json.loads(bare.run(*asked, *more).stdout)["motions"] for more in ((), sets))
    assert plain[0]["mean_joint_error_rad"] != changed[0]["mean_joint_error_rad"]
    assert not changed[0]["fell"]


def test_a_policy_that_cannot_stand_fails_the_suite_and_the_cases_are_named(bare: Home, limp: str) -> None:
    done = bare.run(*QUICK, "--checkpoint", limp, "--only", "stand", "--only", "push", "builtin:stand")
    assert done.returncode == 1, done.stderr
    assert "stand: stand 60 s: fell at " in done.stdout
    assert "push: standing, 0.4 m/s towards 0° at 3 s: fell at " in done.stdout
    assert "push: … and 8 more" in done.stdout
    assert "16 failed" in done.stdout
    left_min = [float(line.split()[2]) for line in done.stderr.splitlines() if line.endswith(" min left")]
    assert left_min[-1] == 0.0, "17 of 17 are done"
    assert len(left_min) == 17
    assert "tracker: stand: stand 60 s: fell at" in done.stderr, "falls are told as they happen"


def test_a_policy_that_stands_keeps_the_promise_beside_one_that_does_not(bare: Home, limp: str) -> None:
    asked = (*QUICK, "--only", "stand", "--only", "track", "builtin:stand", "--against", "tracker")
    done = bare.run(*asked, "--against-checkpoint", limp)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[:5] for line in lines[1:5]] == [
        ["stand", "tracker", "builtin:tracker.onnx", "1", "0"],
        ["stand", "tracker", "limp.onnx", "1", "1"],
        ["track", "tracker", "builtin:tracker.onnx", "1", "0"],
        ["track", "tracker", "limp.onnx", "1", "1"],
    ]


def test_json_holds_every_case_and_markdown_a_table(bare: Home) -> None:
    asked = (*QUICK, "--only", "track", "builtin:stand", "builtin:stand#mirror", "--jobs", "1")
    said = json.loads(bare.run(*asked, "--json").stdout)
    assert set(said) == {"extent", "limits", "missing", "policies", "wall_s", "processes"}
    (policy,) = said["policies"]
    assert policy["rig"]["checkpoint"] == "builtin:tracker.onnx"
    assert [(case["case"], case["falls"]) for case in policy["cases"]] == [
        ("builtin:stand", []), ("builtin:stand#mirror", []),
    ]  # fmt: skip
    assert [(group["group"], group["runs"], group["failures"]) for group in policy["groups"]] == [("track", 2, [])]
    assert bare.run(*asked, "--markdown").stdout.startswith("| group | policy | runs | falls |")


@pytest.fixture
def statue(tmp_path: Path) -> tuple[str, ...]:
    network = onnx_file(tmp_path / "statue.onnx", 48, 12, scale=0.0)
    return ("--robot", "go1-mujoco", "--policy", "playground-go1", "--checkpoint", str(network))


def test_a_policy_of_velocities_is_judged_by_case(bare: Home, statue: tuple[str, ...]) -> None:
    asked = ("rehearse", "--suite", "--quick", "--only", "follow", "--only", "gate", *statue)
    done = bare.run(*asked, "--jobs", "2")
    assert done.returncode == 1, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[0][:4] == ["group", "policy", "case,", "commanded"]
    assert [line[-1] for line in lines[1:12]] == ["failed"] * 8 + ["kept"] * 3, "it stands, and stops well"
    assert "follow: vx +0.75: vx -0.00 of +0.75" in done.stdout.replace("+0.00 of", "-0.00 of")
    assert "seeds" not in done.stdout


def test_json_of_velocities_holds_what_was_asked_and_measured_and_a_page_shows_it(
    bare: Home, statue: tuple[str, ...], tmp_path: Path
) -> None:
    page = tmp_path / "walks.png"
    asked = ("rehearse", "--suite", "--quick", "--only", "hand-over", *statue, "--jobs", "1", "--json")
    done = bare.run(*asked, "--plot", str(page))
    assert done.returncode == 0, done.stderr
    assert f"saved {page}" in done.stderr
    assert page.read_bytes().startswith(b"\x89PNG")
    (policy,) = json.loads(done.stdout)["policies"]
    assert [case["asked"] for case in policy["cases"]] == [[0, 0, 0], [0.75, 0, 0], [0.75, 0, 0.6]]
    assert [case["turns"]["count"] for case in policy["cases"]] == [12, 12, 12]
    assert policy["cases"][1]["velocity"]["stretches"][-1]["commanded"] == [0.75, 0, 0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--suite", "builtin:wave"), "policy 'playground-go1' follows velocities; its suite plays no motions"),
        (("--suite", "--only", "track"), "the suite of policy 'playground-go1' has no group track"),
        (("--suite", "--only", "stand", "--plot", "a.png"), "--plot draws velocities that were followed; no case"),
        (("--suite", "--hand-over", "holosma"), "unknown policy 'holosma' (did you mean 'holosoma'?)"),
        (("velocity:stand", "--plot", "a.png"), "--plot goes with --suite"),
        (("velocity:stand", "--hand-over", "holosoma"), "--hand-over goes with --suite"),
    ],
)
def test_what_has_no_place_in_the_suite_of_velocities_is_told_in_a_line(
    bare: Home, statue: tuple[str, ...], arguments: tuple[str, ...], told: str
) -> None:
    assert told in one_line(bare.run("rehearse", *statue, *arguments))


def test_an_interrupt_ends_the_children_too(bare: Home) -> None:
    with bare.running("rehearse", "--suite", *TRACKER, "--jobs", "2", "--only", "stand", "--only", "arms") as suite:
        suite.wait_for("3 runs in 2 processes")
        children = Path(f"/proc/{suite.process.pid}/task/{suite.process.pid}/children")
        wait_until(lambda: len(children.read_text().split()) >= 2)
        pids = [int(pid) for pid in children.read_text().split()]
        suite.interrupt()
        code, out = suite.finish()
    assert code == 130
    assert out == ""
    assert suite.lines[-1] == "station: interrupted"
    wait_until(lambda: are_gone(pids))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "name a motion to rehearse, for example builtin:wave; or evaluate a policy with --suite"),
        (("builtin:wave", "--quick"), "--quick goes with --suite"),
        (("builtin:wave", "--only", "push"), "--only goes with --suite"),
        (("builtin:wave", "--markdown"), "--markdown goes with --suite"),
        (("--suite", "--only", "pushes"), "'pushes' is not one of 'stand', 'track', 'unseen', 'follow', 'push'"),
        (("--suite", "--against", "twist3"), "unknown policy 'twist3' (did you mean 'twist'?)"),
        (("--suite", "builtin:wve"), "unknown built-in motion 'wve' (did you mean 'wave'?)"),
        (("builtin:wave", "--set", "policy_options.wrist=real"), "policy 'tracker' has no option 'wrist'"),
        (("builtin:wave", "--set", "robot_options.phsics_dt_s=0.002"), "unknown key 'phsics_dt_s' (did you mean"),
        (("builtin:wave", "--set", "policy=twist2"), "--set policy=…: name it with --policy"),
        (("builtin:wave", "--set", "rate=50"), "--set: unknown key 'rate' (did you mean 'rate_hz'?)"),
        (("builtin:wave#speed=fast", "--jobs", "1"), "speed is 'fast'; expected a number, for example 1.2"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_or_does_not_exist_is_told_in_a_line(
    bare: Home, arguments: tuple[str, ...], told: str
) -> None:
    assert told in one_line(bare.run("rehearse", *TRACKER, *arguments))
