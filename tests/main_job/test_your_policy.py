"""The example of `docs/your-policy.md`, as it stands there, installed as a package of somebody else's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.main_job.page_package import install
from tests.main_job.station_runs import LOCK_STEP, Terminal, up

CHECKPOINT = "zoo:policies/holosoma_fastsac_g1_29dof.onnx"
MOTION = "builtin:walk-forward"

pytestmark = [pytest.mark.assets, pytest.mark.timeout(300), pytest.mark.usefixtures("processes")]


@pytest.fixture
def terminal(tmp_path: Path) -> Terminal:
    """A user's terminal in whose Python the package is installed."""
    return install("your-policy.md", "holosoma-walk", tmp_path)


def test_example_walks_and_its_episode_is_audited_with_its_option(terminal: Terminal) -> None:
    policy = ("g1.policy=holosoma-walk", f"g1.checkpoint={CHECKPOINT}", "g1.policy_options.speed=0.8")
    done = terminal.run(*up("own-policy", *LOCK_STEP, *policy, f"motion.motion={MOTION}"))
    assert done.returncode == 0, done.stdout + done.stderr
    episode = str(terminal.episode("own-policy"))
    check = terminal.json("check", episode)
    (robot,) = check["steps"]
    assert (check["falls"], robot["missing_steps"], check["verdict"]) == (0, 0, "good"), check["reasons"]
    audit = terminal.json("audit", episode)
    assert (audit["policy"], audit["steps"]) == ("holosoma-walk", robot["steps"])
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)
    replay = terminal.json("replay", episode, "--to", "sim")
    assert (replay["different"], replay["fell"]) == (0, False)


def test_example_is_found_by_its_name_in_a_rehearsal(terminal: Terminal) -> None:
    rehearsal = terminal.json("rehearse", MOTION, "--policy", "holosoma-walk", "--checkpoint", CHECKPOINT)
    assert [motion["fell"] for motion in rehearsal["motions"]] == [False]


def test_an_option_that_the_class_does_not_have_is_refused_in_one_line(terminal: Terminal) -> None:
    policy = ("g1.policy=holosoma-walk", f"g1.checkpoint={CHECKPOINT}", "g1.policy_options.sped=0.8")
    done = terminal.run(*up("own-policy", *policy, f"motion.motion={MOTION}"))
    assert done.returncode == 1
    assert "has no option 'sped' (did you mean 'speed'?)" in done.stderr
