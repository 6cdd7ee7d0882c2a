"""Rules that a lab can edit: what a file may say, and what is made of it."""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
import pytest

from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.quality.findings import Quality
from station.episode.quality.rule_file import SHIPPED, Limits
from station.episode.quality.rules import RULES
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.errors import BadFile, ConfigError
from tests.episode.synthetic import EpisodeBuilder, walk


def judged(tmp_path: Path, text: str, *, event: str = "estop") -> Quality:
    tmp_path.mkdir(exist_ok=True)
    rules = tmp_path / "rules.yaml"
    rules.write_text(text)
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=1.0, rate_hz=30.0)
    builder.event(event, at_s=0.5)
    return check(open_episode(builder.finish()), rule_file.load(rules))


def test_every_rule_that_is_asked_stands_in_the_file_that_ships_and_the_other_way_round() -> None:
    named = {field.encode_name for field in msgspec.structs.fields(Limits)}
    assert named == set(RULES)


def test_a_file_that_says_nothing_leaves_everything_as_it_ships(tmp_path: Path) -> None:
    quality = judged(tmp_path, "{}")
    assert {(reason.rule, reason.verdict) for reason in quality.reasons} == {("estop", "reject"), ("slow", "usable")}


def test_a_rule_can_be_turned_off_in_either_way_that_people_write_it(tmp_path: Path) -> None:
    assert [reason.rule for reason in judged(tmp_path, "estop: off\nslow: {verdict: off}").reasons] == []


def test_a_rule_can_be_given_its_verdict_and_a_limit(tmp_path: Path) -> None:
    quality = judged(tmp_path, "estop: {verdict: usable}\nslow: {verdict: reject, below_share: 0.65}")
    assert {(reason.rule, reason.verdict) for reason in quality.reasons} == {("slow", "reject"), ("estop", "usable")}


def test_a_rule_with_two_limits_says_no_worse_than_it_was_given(tmp_path: Path) -> None:
    text = "slow: off\nestop: off\ngap: {usable_above_s: 0.01, reject_above_s: 0.02, verdict: %s}"
    assert judged(tmp_path / "a", text % "reject").verdict == "reject"
    assert judged(tmp_path / "b", text % "usable").verdict == "usable"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("gapp: off", "unknown key 'gapp' (did you mean 'gap'?)"),
        ("gap: {usable_above: 1}", "gap: unknown key 'usable_above' (did you mean 'usable_above_s'?)"),
        ("gap: {usable_above_s: 3}", "the limit for usable, 3, lies above the one for reject, 1"),
        ("gap: {usable_above_s: fast}", "gap.usable_above_s: expected float, got 'fast'"),
        ("estop: {verdict: bad}", "estop.verdict: expected off or reject or usable, got 'bad'"),
        ("gap: 3", "gap: expected verdict and limits, or off; got 3"),
        ("slow: {below_share: .nan}", "below_share: expected a number, got nan"),
        ("- gap", "expected a mapping"),
    ],
)
def test_what_a_file_gets_wrong_is_told_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    rules = tmp_path / "rules.yaml"
    rules.write_text(text)
    with pytest.raises(ConfigError) as caught:
        rule_file.load(rules)
    assert told in str(caught.value)
    assert str(caught.value).startswith(str(rules))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match="no such file"):
        rule_file.load(tmp_path / "rules.yaml")


def test_rules_of_a_user_lie_where_their_settings_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert rule_file.of_user() == rule_file.shipped()
    (tmp_path / "station").mkdir()
    (tmp_path / "station" / "quality.yaml").write_text("gap: off")
    assert rule_file.of_user().limits.gap.verdict == "off"


def test_hashes_of_the_rules_stand_in_the_manifest(tmp_path: Path) -> None:
    rules = tmp_path / "rules.yaml"
    rules.write_text("slow: off")
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=1.0)
    folder = builder.finish()
    write_measured(folder, check(open_episode(folder), rule_file.load(rules)))
    shipped, own = load_manifest(folder).quality["rules"]
    assert shipped == {"file": "shipped", "sha256": hashlib.sha256(SHIPPED.read_bytes()).hexdigest()}
    assert own == {"file": str(rules), "sha256": hashlib.sha256(rules.read_bytes()).hexdigest()}
