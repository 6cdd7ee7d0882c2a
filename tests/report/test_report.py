"""The HTML report: whole, safe to open whatever strangers wrote, small for many episodes, and right in its figures."""

from __future__ import annotations

import base64
import io
import re
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from station.bus import keys
from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest
from station.errors import StationError
from station.report import figures, html, make
from station.report.gather import Episode, gather
from tests.episode.synthetic import EpisodeBuilder, walk

EVIL = "<script>alert('x')</script>\"'><img src=x onerror=alert(1)>"
VOID = ("br", "img", "meta")


class Page(HTMLParser):
    """Reads a page as a browser does, and fails where an element is not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str | None]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, name: str) -> list[str]:
        return [value or "" for key, value in self.attributes if key == name]


def picture(shade: int) -> bytes:
    made = io.BytesIO()
    Image.new("RGB", (64, 48), (shade, 40, 40)).save(made, format="jpeg")
    return made.getvalue()


def episode(data: Path, number: int = 1, *, seconds: float = 1.0, fall: bool = False, camera: bool = False,
            manifest: dict[str, Any] | None = None, task: str = "walk") -> Path:  # fmt: skip
    builder = EpisodeBuilder(data, task=task, number=number)
    walk(builder, seconds=seconds)
    if fall:
        builder.event("fall", at_s=0.5, severity="error", tilt_rad=1.2, contacts=[])
    for frame in range(20 if camera else 0):
        value = b"no picture" if frame == 19 else picture(10 * frame)
        builder.write({keys.camera_image("head"): value}, at_s=0.1 + frame / 30, writer="camera")
    return builder.finish(manifest)


def report(folders: list[Path], out: Path, *, named: bool = True, pictured: int = make.PICTURED) -> Page:
    found, unread = gather(folders, rule_file.shipped(), named=named)
    make.write(out, found, unread, title="Task walk", pictured=pictured)
    return Page(out.read_text(encoding="utf-8"))


def timed(number: int, *, seconds: float = 30.0, hour: int = 9) -> dict[str, Any]:
    started = f"2026-11-21T{hour:02d}:{number:02d}:00+00:00"
    return {"timing": {"started": started, "duration_s": seconds}}


def test_an_episode_is_shown_with_everything_that_is_known_of_it(tmp_path: Path) -> None:
    page = report([episode(tmp_path, fall=True, camera=True)], tmp_path / "r.html")
    for told in ("2026-11-21-g1-walk-0001", "1 fall(s)", "What happened when", "How it was followed", "Camera head",
                 "Latency of each stage", "Streams (", "Events (", "sha256", "What each column is",
                 "left_knee_pos", "station check"):  # fmt: skip
        assert told in page.text, told
    images = page.all("src")
    assert len(images) == 1 + 6  # the plot, and seven pictures of which one is none
    for source in images:
        Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))).verify()


def test_a_page_fetches_nothing_and_runs_nothing(tmp_path: Path) -> None:
    page = report([episode(tmp_path, camera=True)], tmp_path / "r.html")
    assert not page.tags["script"] + page.tags["link"] + page.tags["iframe"]
    assert all(source.startswith("data:image/") for source in page.all("src"))
    assert all(link.startswith("#") for link in page.all("href"))
    assert "default-src 'none'" in " ".join(page.all("content"))


def test_every_link_has_its_place(tmp_path: Path) -> None:
    folders = [episode(tmp_path, number, manifest=timed(number)) for number in (1, 2)]
    page = report(folders, tmp_path / "r.html")
    assert {link[1:] for link in page.all("href")} <= set(page.all("id"))
    assert sum(name.startswith("ep-") for name in page.all("id")) == 2


def test_what_strangers_wrote_is_text_and_nothing_else(tmp_path: Path) -> None:
    said = {
        "episode_id": EVIL, "task": {"name": EVIL, "instruction": EVIL}, "operator": {"id": EVIL, "interface": EVIL},
        "policy": {"name": EVIL, "checkpoint": EVIL, "sha256": EVIL, "runtime": EVIL, "command": EVIL},
        "robot": {"suffix": EVIL, "facts": {"model": EVIL}}, "motions": [{"file": EVIL, "sha256": EVIL}],
        "marks": [{"at_s": 0.2, "label": EVIL}, {"at_s": 0.3, "label": f"discarded: {EVIL}"}],
        "quality_flags": {"discarded": True}, "runbook": {EVIL: EVIL}, "holes": [{"from_s": 0.1, "reason": EVIL}],
    }  # fmt: skip
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=1.0)
    builder.event(EVIL, at_s=0.4, severity=EVIL, source="g1", reason=EVIL)
    builder.write({EVIL: b"1", keys.camera_image(EVIL): picture(1)}, at_s=0.5, writer="camera")
    page = report([builder.finish(said)], tmp_path / "r.html")
    assert EVIL in page.text
    assert not page.tags["script"]
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    assert all(source.startswith("data:image/") for source in page.all("src"))


def test_a_text_that_would_steer_a_reader_is_shown_as_what_it_is() -> None:
    assert html.tag("p", "a\u202eb\x1b[2J") == r"<p>a\u202eb\x1b[2J</p>"
    assert html.tag("p", html.tag("b", "<"), class_='"x') == '<p class="&quot;x"><b>&lt;</b></p>'


def test_many_episodes_have_pictures_where_they_are_needed(tmp_path: Path) -> None:
    folders = [
        episode(tmp_path, number, fall=number == 1, manifest=timed(number, seconds=1.1)) for number in range(1, 4)
    ]
    page = report(folders, tmp_path / "few.html", named=False, pictured=2)
    assert len(page.all("src")) == 2
    drawn = re.findall(
        r'id="ep-[^"]*-(\d{4})">(?:(?!</section>).)*What happened', (tmp_path / "few.html").read_text(), re.S
    )
    assert drawn == ["0001", "0003"], "the one that fell, then the newest"
    assert "drawn for 2 of them" in page.text
    assert (tmp_path / "few.html").stat().st_size < 3 * 40_000 + 2 * 150_000
    assert len(report(folders, tmp_path / "all.html", named=True, pictured=0).all("src")) == 3


def test_what_was_measured_is_taken_and_what_was_not_is_measured(tmp_path: Path) -> None:
    folders = [episode(tmp_path, 1), episode(tmp_path, 2)]
    measured = check(open_episode(folders[0]))
    measured.ends_s = (0.0, 77.0)  # so that it can be told whose number it is
    write_measured(folders[0], measured)
    found, _ = gather(folders, rule_file.shipped(), named=True)
    assert [round(one.quality.length_s) for one in found] == [77, 1]
    assert load_manifest(folders[1]).quality == {}, "a report changes no manifest"


def test_an_episode_that_was_discarded_after_its_check_is_told_with_the_reason(tmp_path: Path) -> None:
    folder = episode(tmp_path, manifest={"marks": [{"at_s": 0.5, "label": "discarded: cup fell"}]})
    write_measured(folder, check(open_episode(folder)))
    text = (folder / "manifest.yaml").read_text()
    (folder / "manifest.yaml").write_text(
        re.sub(r"(quality_flags:.*?discarded: )false", r"\1true", text, count=1, flags=re.S)
    )
    (found,), _ = gather([folder], rule_file.shipped(), named=True)
    assert (found.quality.verdict, found.discarded_for) == ("reject", "cup fell")
    assert "cup fell" in report([folder], tmp_path / "r.html").text


def test_a_broken_episode_is_told_of_and_the_others_are_reported(tmp_path: Path) -> None:
    whole, broken = episode(tmp_path, 1), episode(tmp_path, 2)
    (broken / "signals.mcap").write_bytes(b"nothing like it")
    page = report([whole, broken], tmp_path / "r.html")
    assert "Not in this report (1)" in page.text
    assert "2026-11-21-g1-walk-0002" in page.text


def test_a_torn_episode_is_drawn_as_far_as_it_goes(tmp_path: Path) -> None:
    folder = episode(tmp_path, seconds=30.0)
    signals = folder / "signals.mcap"
    signals.write_bytes(signals.read_bytes()[:-8000])
    page = report([folder], tmp_path / "r.html")
    assert "torn" in page.text
    assert len(page.all("src")) == 1


def loaded(tmp_path: Path, folders: list[Path]) -> list[Episode]:
    return gather(folders, rule_file.shipped(), named=True)[0]


def test_takes_per_hour_are_those_of_sessions_without_breaks(tmp_path: Path) -> None:
    # Four takes of 30 s that begin each minute: 4 in 3.5 min. Then a break, and one that stands alone.
    folders = [episode(tmp_path, number, manifest=timed(number)) for number in range(1, 5)]
    folders.append(episode(tmp_path, 5, manifest=timed(0, hour=11)))
    pace = figures.pace(loaded(tmp_path, folders))
    assert (pace.takes, pace.sessions) == (4, 1)
    assert pace.per_hour == pytest.approx(4 / (3.5 / 60))
    assert figures.pace([]).per_hour is None


def test_lengths_fall_into_bars_with_round_limits(tmp_path: Path) -> None:
    folders = [episode(tmp_path, number, seconds=0.5 + number) for number in range(3)]
    bins = figures.lengths(loaded(tmp_path, folders))
    assert [one.from_s for one in bins] == [0.0, 1.0, 2.0]
    assert [sum(one.counts.values()) for one in bins] == [1, 1, 1]


def test_reasons_are_counted_once_for_each_episode(tmp_path: Path) -> None:
    folders = [episode(tmp_path, 1, fall=True), episode(tmp_path, 2, fall=True), episode(tmp_path, 3)]
    ((rule, rejected, usable, text),) = figures.reasons(loaded(tmp_path, folders))
    assert (rule, rejected, usable) == ("fell", 2, 0)
    assert "fall" in text


def test_a_folder_that_is_not_there_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(StationError, match="cannot be written") as caught:
        report([episode(tmp_path)], tmp_path / "nowhere" / "r.html")
    assert "\n" not in str(caught.value)


def test_no_half_page_is_left_when_something_breaks(tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    out.write_text("the old one")
    found, _ = gather([episode(tmp_path)], rule_file.shipped(), named=True)

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make.write(out, found, [], title="x", tell=stop)
    assert out.read_text() == "the old one"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
