"""What a check says of the bus: what several servers suffered at once is one interruption, with its time and cost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station.cli.quality import print_quality
from station.episode.quality.check import check
from station.episode.quality.findings import Interruption, Quality
from station.episode.reading.reader import open_episode
from tests.episode.synthetic import EpisodeBuilder, walk

FAST = {"seconds": 4.0}


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    made = EpisodeBuilder(tmp_path)
    walk(made, **FAST)
    return made


def checked(builder: EpisodeBuilder, manifest: dict[str, Any] | None = None) -> Quality:
    return check(open_episode(builder.finish(manifest)))


def only(quality: Quality) -> Interruption:
    (found,) = quality.interruptions
    return found


def reasons(quality: Quality) -> dict[str, str]:
    return {reason.rule: reason.text for reason in quality.reasons}


def test_a_silence_that_three_servers_tell_of_is_one_and_has_the_time_at_which_it_began(
    builder: EpisodeBuilder,
) -> None:
    for source, seconds in (("g1", 2.0), ("motion", 1.98), ("recorder", 1.6)):
        builder.event("bus-silent", at_s=4.2, source=source, seconds=seconds, began_ago_s=seconds + 1.2)
    quality = checked(builder)
    found = only(quality)
    assert (found.kind, found.at_s, found.seconds) == ("bus-silent", 1.0, 2.0)
    assert found.told_by == ["g1", "motion", "recorder"]
    assert reasons(quality) == {"bus-silent": "the bus was silent 1 time(s), first at 1.00 s for 2.00 s"}
    assert quality.verdict == "usable"


def test_a_loss_costs_what_all_servers_lost(builder: EpisodeBuilder) -> None:
    for source, lost in (("g1", 30), ("motion", 12)):
        builder.event(
            "bus-back", at_s=3.0, source=source, seconds=0.2, began_ago_s=1.4, lost_writes=lost, reason="gone"
        )
    quality = checked(builder)
    found = only(quality)
    assert (found.kind, found.at_s, found.lost, found.reason) == ("bus-lost", 1.6, 42, "gone")
    assert (quality.bus_lost, quality.verdict) == (1, "usable")
    assert "42 writes lost" in reasons(quality)["bus-lost"]


def test_losses_apart_in_time_are_counted_apart(builder: EpisodeBuilder) -> None:
    for at_s in (1.5, 3.5):
        builder.event("bus-back", at_s=at_s, seconds=0.1, began_ago_s=1.1, lost_writes=1)
    assert [item.at_s for item in checked(builder).interruptions] == [0.4, 2.4]


def test_a_server_that_did_not_hear_while_the_bus_was_gone_is_not_told_of_twice(builder: EpisodeBuilder) -> None:
    builder.event("bus-back", at_s=3.0, source="g1", seconds=0.2, began_ago_s=1.4, lost_writes=0)
    builder.event("watch-back", at_s=3.0, source="motion", seconds=0.3, began_ago_s=1.4)
    assert only(checked(builder)).kind == "bus-lost"


def test_a_cut_link_that_goes_on_is_told_of_and_costs_the_episode_nothing(builder: EpisodeBuilder) -> None:
    for at_s in (1.0, 1.2, 3.0):
        builder.event("tap-resumed", at_s=at_s, source="recorder", seconds=0.01, reason="cut")
    quality = checked(builder)
    assert [(item.kind, item.lost) for item in quality.interruptions] == [("tap-cut", 0)] * 3
    assert quality.verdict == "good"


def test_holes_and_restarts_come_from_the_manifest(builder: EpisodeBuilder) -> None:
    manifest = {
        "recorder": {"backend": "replication", "is_lossless": True, "restarts": 1},
        "holes": [{"from_s": 2.5, "to_s": 3.0, "lost": 48, "reason": "the bus was restarted"}],
        "recovery": [{"kind": "resumed", "at_s": 1.5, "away_s": 0.9, "by": "offset"}],
    }
    quality = checked(builder, manifest)
    assert [(item.kind, item.at_s, item.seconds, item.lost) for item in quality.interruptions] == [
        ("recorder-restart", 0.6, 0.9, 0), ("hole", 2.5, 0.5, 48),
    ]  # fmt: skip
    text = "1 hole(s), the first at 2.50 s for 0.50 s, 48 writes lost: the bus was restarted"
    assert reasons(quality) == {"holes": text}


def test_a_bus_that_never_came_back_ends_the_episode_and_is_told_of(builder: EpisodeBuilder) -> None:
    manifest = {
        "recorder": {"backend": "replication", "is_lossless": True, "ended_by": "bus-lost"},
        "timing": {"duration_s": 4.5},
    }
    found = only(checked(builder, manifest))
    assert (found.kind, found.at_s, found.seconds) == ("bus-lost", 4.5, None)


def test_an_event_of_somebody_else_with_such_a_name_breaks_nothing(builder: EpisodeBuilder) -> None:
    builder.event({"not": "a name"}, at_s=0.9)  # type: ignore[arg-type]
    builder.event("bus-silent", at_s=1.0, seconds="long", began_ago_s=None, reason=3)
    builder.event("bus-back", at_s=3.0, lost_writes="many", seconds=1e308)
    assert [(item.seconds, item.lost) for item in checked(builder).interruptions] == [(0.0, None)] * 2


def test_what_was_over_before_the_episode_began_is_none_of_its_business(builder: EpisodeBuilder) -> None:
    builder.event("bus-silent", at_s=0.5, seconds=2.0, began_ago_s=3.0)
    quality = checked(builder)
    assert (quality.interruptions, quality.verdict) == ([], "good")


def test_a_file_full_of_such_events_is_looked_at_no_further_than_a_thousand(builder: EpisodeBuilder) -> None:
    for n in range(3000):
        builder.event("tap-resumed", at_s=1.0 + n * 1e-4, source="recorder", seconds=0.0)
    assert len(checked(builder).interruptions) == 1000


def test_a_person_reads_what_happened_when_and_what_it_cost(
    builder: EpisodeBuilder, capsys: pytest.CaptureFixture[str]
) -> None:
    builder.event("bus-silent", at_s=3.0, source="g1", seconds=2.0, began_ago_s=2.5)
    builder.event("tap-resumed", at_s=3.5, source="recorder", seconds=0.01, reason="cut")
    print_quality(checked(builder))
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "bus: silent once for 2.00 s; recording link cut once and resumed, for 0.01 s (0 writes lost)" in lines
    assert any(line.startswith("0.50 s 2.00 s – bus-silent g1") for line in lines), lines
    assert any(line.startswith("3.49 s 0.01 s 0 tap-cut: cut recorder") for line in lines), lines


def test_where_nothing_happened_a_line_says_so(builder: EpisodeBuilder, capsys: pytest.CaptureFixture[str]) -> None:
    print_quality(checked(builder))
    assert "bus: no interruption" in capsys.readouterr().out
