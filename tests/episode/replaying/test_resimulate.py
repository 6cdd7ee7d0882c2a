"""Replaying to a simulation: a lock-step episode comes out the same, and what is not the same is reported."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from servers.g1 import G1Config
from station.cli.main import cli
from station.control.rig import PolicyChoice, build
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.replaying.audit import audit
from station.episode.replaying.resimulate import to_sim
from station.episode.storage.manifest import load_manifest, save_manifest
from station.errors import EpisodeError
from station.suite import attacks
from tests.episode import lock_step
from tests.episode.synthetic import EpisodeBuilder, walk


def test_lock_step_episode_comes_out_the_same_to_the_last_bit(tmp_path: Path) -> None:
    found = to_sim(open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=3.0)))
    assert found.lock_step
    assert (found.steps, found.different, found.gates_different) == (150, 0, 0)
    assert found.max_q_difference_rad == found.max_root_difference_m == 0.0
    assert found.notes == []
    assert not found.fell


def test_a_first_state_from_long_before_the_recording_is_told_and_all_else_compared(tmp_path: Path) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=0.2, with_first_state=False)
    found = to_sim(open_episode(folder))
    assert (found.steps, found.without_state, found.different, found.warm_up_steps) == (9, 1, 0, 0)
    done = CliRunner().invoke(cli, ["replay", str(folder), "--to", "sim"])
    assert (done.exit_code, done.output.splitlines()[0]) == (
        0, "1 step not compared: the state before it was not recorded",
    )  # fmt: skip


def test_a_replay_that_compared_nothing_is_no_success(tmp_path: Path) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=0.02, with_first_state=False)
    assert CliRunner().invoke(cli, ["replay", str(folder), "--to", "sim"]).exit_code == 1


def test_another_physics_step_is_reported_from_the_first_step_that_differs(tmp_path: Path) -> None:
    reader = open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=1.0))
    found = to_sim(reader, changes={"physics_dt_s": 0.001})
    assert found.first_different == 1
    assert found.max_q_difference_rad > 0.0
    assert any("physics_dt_s" in note for note in found.notes)


def test_episode_that_begins_late_is_warmed_up_and_does_not_pretend(tmp_path: Path) -> None:
    found = to_sim(open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=2.0, skip=50)))
    assert (found.warm_up_steps, found.steps) == (50, 50)
    assert found.different > 0  # the commands of the first second are not in the file


def test_episode_without_a_stated_configuration_is_refused(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.2)
    with pytest.raises(EpisodeError, match="no low-level server has stated its configuration"):
        to_sim(open_episode(builder.finish()))


def restated(folder: Path, **facts: object) -> EpisodeReader:
    """Change what the low-level server of an episode has stated."""
    manifest = load_manifest(folder)
    manifest.servers["g1"] |= facts
    save_manifest(manifest, folder)
    return open_episode(folder)


@pytest.mark.usefixtures("processes")
def test_a_server_of_another_name_is_known_by_its_kind_and_no_other_server_is_loaded(tmp_path: Path) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=0.2)
    restated(folder, server="left", kind="g1")
    done = subprocess.run([sys.executable, "-B", "-c", REPLAY, str(folder)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["10", "0", "servers.g1"]


REPLAY = """
import sys
from station.episode.reading.reader import open_episode
from station.episode.replaying.resimulate import to_sim
found = to_sim(open_episode(sys.argv[1]))
print(found.steps, found.different, *sorted(name for name in sys.modules if name.startswith("servers.")))
"""


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"kind": "h1"}, "of a kind that is not installed here: unknown server 'h1'"),
        ({"config": {"rate_hz": "fast"}}, "the configuration of its g1 server is none of this version"),
        ({"kind": "kassow", "config": {"host": "sim"}}, "an arm's controller keeps its own time"),
    ],
)
def test_a_configuration_that_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, facts: dict[str, object], words: str
) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=0.1)
    with pytest.raises(EpisodeError, match=words) as caught:
        to_sim(restated(folder, **facts))
    assert "\n" not in str(caught.value)
    assert ("--name" in str(caught.value)) == ("kind" not in facts), "only who tells no kind may be of another one"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("left", "its low-level server is called like no kind that is installed here: unknown server 'left'"),
        ("motion", "the configuration of its motion server is none of this version"),
    ],
)
def test_a_server_that_told_its_name_alone_is_read_as_its_kind_once_that_is_added(
    tmp_path: Path, name: str, words: str
) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=0.1)
    with pytest.raises(EpisodeError, match=words) as caught:
        to_sim(restated(folder, server=name))
    told = str(caught.value)
    assert told.endswith(
        f"; if that name was given with --name, write `kind: KIND` into servers.g1 of {folder / 'manifest.yaml'}"
    )
    assert "\n" not in told
    assert to_sim(restated(folder, kind="g1")).different == 0


@pytest.mark.parametrize(
    "other",
    [
        PolicyChoice(policy="tracker", policy_options={"wrist_gains": "training"}),
        pytest.param(PolicyChoice(policy="twist2"), marks=pytest.mark.assets),
    ],
)
def test_a_hand_over_comes_out_the_same_to_the_last_bit(tmp_path: Path, other: PolicyChoice) -> None:
    """In a manifest names stand in the order of the alphabet."""
    config = G1Config(pace="command", physics_dt_s=0.002, blend_s=0.2, policies={"another": other})
    switches = {60: "another", 100: "tracker"}
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=3.0, config=config, switches=switches)
    found = to_sim(open_episode(folder))
    assert (found.steps, found.different, found.gates_different) == (150, 0, 0)


@pytest.mark.parametrize("skip", [0, 100])
def test_commands_beyond_the_envelope_are_derived_bit_for_bit(tmp_path: Path, skip: int) -> None:
    """A gate that begins in the middle knows no averages: it proves what they do not bound, and says what it cannot."""
    rig = build(G1Config().rig)
    wild, _ = attacks.commands("jump", 14, rig.command_format, rig.envelopes, [], seconds=2.0, period_s=rig.period_s)
    stream = np.concatenate([wild, np.tile(rig.command_format.default, (60, 1)), wild])
    rig.robot.close()
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=5.0, commands=stream, skip=skip)
    reader = open_episode(folder)
    found = audit(reader)
    assert (found.different, found.commands.different, found.gates_different) == (0, 0, 0)
    assert found.commands.compared >= (30 if skip else 250)
    assert bool(found.commands_not_proven) == (skip > 0)
    (text,) = load_manifest(folder).servers["g1"]["envelopes"]
    stated = json.loads(text)
    slower = stated["bounded"] | {"rate": [0.5 * each for each in stated["bounded"]["rate"]]}
    for forgery in (stated | {"bounded": slower}, json.dumps(stated | {"bounded": slower})):
        forged = audit(restated(folder, envelopes=[forgery]))
        assert (forged.commands.different > 0) == (not skip)
    for broken in ([{"bounded": 3}], ["{"], [3], 3):
        found = audit(restated(folder, envelopes=broken))
        assert found.commands.compared == 0
        (why,) = found.commands_not_proven
        assert why.startswith("the manifest does not say which envelope the gate kept to: ")


def test_commands_beyond_the_envelope_are_simulated_within_the_one_of_then(tmp_path: Path) -> None:
    rig = build(G1Config().rig)
    stream, _ = attacks.commands("jump", 14, rig.command_format, rig.envelopes, [], seconds=3.0, period_s=rig.period_s)
    rig.robot.close()
    config = G1Config(pace="command", physics_dt_s=0.002)
    mine = tmp_path / "mine.envelope.yaml"
    bounded = rig.envelopes[0].bounded
    slower = msgspec.structs.replace(bounded, rate=tuple(0.6 * each for each in bounded.rate))
    mine.write_bytes(msgspec.json.encode(msgspec.structs.replace(rig.envelopes[0], bounded=slower)))
    config = msgspec.structs.replace(config, envelope=str(mine))
    reader = open_episode(lock_step.record(EpisodeBuilder(tmp_path), seconds=3.0, commands=stream, config=config))
    mine.unlink()
    again = to_sim(reader)
    assert (again.steps, again.different, again.gates_different) == (150, 0, 0)
    without = to_sim(reader, changes={"envelope": "none"})
    assert without.different > 50
    assert "envelope: changed to none" in without.notes
