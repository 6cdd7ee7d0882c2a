"""The audit's word in a verdict: what differs is rejected, what could not be audited is told and is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from station.cli.main import cli
from station.episode.quality import rule_file
from station.episode.quality.standing import standing
from station.episode.reading.reader import open_episode
from station.episode.replaying import in_short
from station.episode.replaying.in_short import audit_in_short
from station.episode.storage.manifest import load_manifest, save_manifest
from tests.episode import lock_step
from tests.episode.replaying.test_gate_audit import Forger, noise
from tests.episode.synthetic import ROBOT, EpisodeBuilder


def checked(folder: Path, *options: str) -> tuple[int, Any]:
    done = CliRunner().invoke(cli, ["check", str(folder), "--json", *options])
    return done.exit_code, json.loads(done.stdout)


def rules(quality: Any) -> set[str]:
    return {reason["rule"] for reason in quality["reasons"]}


def test_an_honest_episode_is_compared_in_four_ways(tmp_path: Path) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=2.0)
    _, quality = checked(folder)
    sound = {"compared": 400, "different": 0, "not_proven": 0, "not_audited": [], "differences": []}
    assert quality["audit"] == sound
    assert "audit-differs" not in rules(quality)
    assert load_manifest(folder).quality["audit"] == quality["audit"]
    told = CliRunner().invoke(cli, ["check", str(folder)]).stdout
    assert "audit: 400 vectors computed again, 0 different" in told


def test_forged_targets_are_rejected_and_stay_so_for_an_export(tmp_path: Path) -> None:
    folder = lock_step.record(Forger(tmp_path, target_=noise), seconds=2.0)
    _, quality = checked(folder, "--no-audit", "--no-write")
    assert (quality["audit"], "audit-differs" in rules(quality)) == (None, False)
    code, quality = checked(folder, "--audit")
    assert (code, quality["audit"]["different"]) == (1, 100)
    assert "audit-differs" in rules(quality)
    found = standing(open_episode(folder), rule_file.shipped(), is_judged_anew=True)
    assert "audit-differs" in {reason.rule for reason in found.reasons}
    code, quality = checked(folder, "--no-audit")
    assert (code, quality["audit"]["different"]) == (1, 100), "a check that audits nothing makes no verdict better"


def test_what_differs_is_told_by_key_and_time(tmp_path: Path) -> None:
    folder = lock_step.record(Forger(tmp_path, target_=noise), seconds=2.0)
    _, quality = checked(folder)
    (reason,) = (reason for reason in quality["reasons"] if reason["rule"] == "audit-differs")
    (found,) = quality["audit"]["differences"]
    assert (found["key"], found["of"]) == (f"target_{ROBOT}", [f"policy_action_{ROBOT}"])
    assert reason["text"].startswith(
        f"target_{ROBOT}: 100 of 100 values are not what policy_action_{ROBOT} give again, the first at "
    )
    assert found["first_s"] == pytest.approx(0.1, abs=0.02)


def test_a_long_episode_is_audited_where_it_is_asked_for_alone(tmp_path: Path, monkeypatch: Any) -> None:
    folder = lock_step.record(Forger(tmp_path, target_=noise), seconds=1.5)
    monkeypatch.setattr(in_short, "LONGEST_S", 1.0)
    _, quality = checked(folder)
    (line,) = quality["audit"]["not_audited"]
    assert line.endswith(" s, longer than 1 s; `station check --audit` audits it all the same")
    assert "audit-differs" not in rules(quality)
    assert checked(folder, "--audit")[1]["audit"]["different"] > 0


def test_a_policy_that_is_not_here_is_told_and_no_reject(tmp_path: Path) -> None:
    folder = lock_step.record(EpisodeBuilder(tmp_path), seconds=1.0)
    changed(folder, checkpoint="/nowhere/policy.onnx")
    manifest = load_manifest(folder)
    manifest.servers["g1"]["config"] = {}  # which would lead to it by its user's name for it
    save_manifest(manifest, folder)
    _, quality = checked(folder, "--audit")
    assert (quality["audit"]["compared"], quality["audit"]["different"]) == (0, 0)
    (line,) = quality["audit"]["not_audited"]
    assert "/nowhere/policy.onnx: no such file" in line
    assert "audit-differs" not in rules(quality)
    told = CliRunner().invoke(cli, ["check", str(folder), "--audit", "--no-write"]).stdout
    assert "not audited: " in told
    assert "audit: nothing was compared" in told


@pytest.mark.parametrize("runtime", ["onnxruntime 9.9 CPU, 64 threads", ""])
def test_other_last_bits_of_another_runtime_are_no_reject(tmp_path: Path, runtime: str) -> None:
    folder = lock_step.record(Forger(tmp_path, policy_obs_=flipped), seconds=1.0)
    assert audit_in_short(open_episode(folder)).different > 0
    changed(folder, runtime=runtime)
    found = audit_in_short(open_episode(folder))
    assert (found.different > 0) is (runtime == "")
    assert len(found.not_audited) == (runtime != "")


def flipped(data: bytes) -> bytes:
    """What a network saw that had rounded its last output otherwise."""
    return bytes([data[0] ^ 1]) + data[1:]


def changed(folder: Path, **policy: str) -> None:
    manifest = load_manifest(folder)
    for facts in manifest.servers.values():
        facts["policy"].update(policy)
    save_manifest(manifest, folder)
