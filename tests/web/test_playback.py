"""Playback of an episode in the page, in a real browser, beside a robot that is live."""

from __future__ import annotations

import contextlib
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from station.api.episode import Episode, open_episode
from station.bus import keys
from station.episode.storage import layout
from tests.episode.synthetic import EpisodeBuilder, walk
from tests.main_job.station_runs import Terminal
from tests.waiting import wait_until
from tests.web.browser import DESKTOP, PHONE, SMALL, Page
from tests.web.conftest import Open
from tests.web.console_process import players
from tests.web.standing import ROBOT, Standing

pytest.importorskip("starlette", reason="needs the extra 'console'")

PART = (
    "(stationPage.playback.time_s - stationPage.playback.start_s) / "
    "(stationPage.playback.length_s - stationPage.playback.start_s)"
)
HOSTILE = '<img src=x onerror="window.hit=1">'


@pytest.fixture(scope="module")
def g1(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Standing]:
    """A station with a robot that stands, in whose folder lies an episode of one that waved before two cameras."""
    folder = tmp_path_factory.mktemp("w") / "w"
    done = Terminal(folder).run("up", "g1-sim-cameras", "--yes", "--record", "--task", "wave", "--for", "30s")
    assert list((folder / "data/wave").iterdir()), done.stdout + done.stderr
    with contextlib.closing(Standing(folder)) as made:
        yield made


@pytest.fixture(scope="module")
def episode(g1: Standing) -> Episode:
    """What a script reads of it."""
    return open_episode(g1.terminal.episode("wave"))


def _link(g1: Standing) -> str:
    return g1.console.links()["operator"]


def _open(page: Page, name: str) -> Page:
    """Press Play of an episode in the list."""
    page.ready()
    page.until(f"[...document.querySelectorAll('#episode-list button b')].some(b => b.textContent === {name!r})")
    page.tab.locator("#episode-list button", has=page.tab.get_by_text(name, exact=True)).first.click()
    page.tab.click("#episode-play")
    return page


def _play(page: Page, name: str = "wave") -> Page:
    """Open an episode, and wait until it is there; it stands where it is then."""
    _open(page, name)
    page.until("stationPage.playback && stationPage.playback.pose")
    page.tab.get_by_role("button", name="Pause", exact=True).click()
    page.until("!stationPage.playback.is_playing && stationPage.playback.is_settled")
    return page


def _go_to(page: Page, time_s: float) -> dict[str, Any]:
    """Go to an instant as the slider does; return what is shown there."""
    page.tab.evaluate(
        "time_s => { const s = document.querySelector('#playback-slider'); s.value = time_s; "
        "s.dispatchEvent(new Event('input')); }",
        time_s,
    )
    page.until(f"stationPage.playback.is_settled && Math.abs(stationPage.playback.time_s - {time_s}) < 1e-6")
    return dict(page.read("stationPage.playback"))


def _newest(episode: Episode, key: str, time_s: float) -> tuple[float, bytes]:
    """What had arrived of a key by an instant."""
    return [value for value in episode.raw(key) if value[0] <= time_s][-1]


def test_the_page_shows_what_a_script_reads_at_that_instant(g1: Standing, episode: Episode, open_page: Open) -> None:
    page = _play(open_page(_link(g1)))
    shown = page.read("stationPage.playback")
    assert shown["length_s"] == pytest.approx(episode.duration_s, abs=1e-6)
    assert page.tab.inner_text("#playback-length") == f"0:{episode.duration_s:05.2f}"
    assert (shown["robot"], shown["cameras"]) == (ROBOT, episode.cameras)
    table = episode.numpy(keys.sim_qpos(ROBOT), *(f"{joint}_pos" for joint in shown["joints"]))
    for time_s in (4.0, 2.5, 5.25, 0.5 * episode.duration_s):
        shown = _go_to(page, time_s)
        row = int(np.searchsorted(table.time_s, shown["time_s"], side="right")) - 1
        np.testing.assert_array_equal(np.float32(shown["pose"]["q"]), table.values[row].astype("f4"))
        assert page.tab.inner_text("#playback-time") == f"0:{time_s:05.2f}"
        assert shown["past"][-1] == pytest.approx(time_s)
        for camera in episode.cameras:
            at_s, data = _newest(episode, keys.camera_image(camera), time_s)
            assert shown["pictures"][camera] == pytest.approx(at_s)
            _expect_picture(page, camera, data)
        _expect_curves(page, shown)


PIXELS = """
([camera, places]) => {
  const figures = [...document.querySelectorAll("#camera-list figure")];
  const { canvas } = figures.find((figure) => figure.querySelector("b").textContent === camera);
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  return places.map(([x, y]) => [...copy.getImageData(x, y, 1, 1).data].slice(0, 3));
}
"""


def _expect_picture(page: Page, camera: str, data: bytes) -> None:
    """Expect some pixels of a recorded picture on the page; two decoders differ a little."""
    with Image.open(io.BytesIO(data)) as picture:
        places = [(x * picture.width // 7, y * picture.height // 7) for x in range(1, 7) for y in range(1, 7)]
        wanted = [picture.convert("RGB").getpixel(place) for place in places]

    def is_there() -> bool:
        found = page.tab.evaluate(PIXELS, [camera, places])
        return float(np.abs(np.subtract(found, wanted)).max()) < 16

    wait_until(is_there)


def _expect_curves(page: Page, shown: dict[str, Any]) -> None:
    """Expect beside each curve the joint's number at the instant that is shown."""
    values = dict(zip(shown["joints"], shown["pose"]["q"], strict=True))
    rows = "[...document.querySelectorAll('.curve p')].map(p => [p.children[0].textContent, p.children[1].textContent])"

    def are_right() -> bool:
        found = page.read(rows)
        return bool(found) and all(text.startswith(f"{values[name.replace(' ', '_')]:.3f} rad") for name, text in found)

    wait_until(are_right)


def test_it_plays_pauses_and_goes_as_fast_as_one_likes(g1: Standing, episode: Episode, open_page: Open) -> None:
    page = _play(open_page(_link(g1)))
    _go_to(page, 1.0)
    page.tab.wait_for_timeout(300)
    assert page.read("stationPage.playback.time_s") == 1.0
    page.tab.get_by_role("button", name="Play", exact=True).click()
    page.until("stationPage.playback.time_s > 1.5")
    for speed in ("4", "0.25", "1"):
        page.tab.select_option("#playback-speed", speed)
        page.until(f"stationPage.playback.speed === {speed}")
        before_s = page.read("stationPage.playback.time_s")
        page.until(f"stationPage.playback.time_s > {before_s} || !stationPage.playback.is_playing")
    page.tab.select_option("#playback-speed", "4")
    page.until("!stationPage.playback.is_playing")
    assert page.read("stationPage.playback.time_s") == pytest.approx(episode.duration_s)
    page.tab.get_by_role("button", name="Play", exact=True).click()
    page.until("stationPage.playback.is_playing && stationPage.playback.time_s < 5")


def test_one_seeks_by_keyboard_pointer_touch_and_by_what_happened(
    g1: Standing, episode: Episode, open_page: Open
) -> None:
    page = _play(open_page(_link(g1), PHONE, has_touch=True))
    slider = page.tab.locator("#playback-slider")
    slider.focus()
    _go_to(page, 2.0)
    for key, time_s in (("ArrowRight", 2.1), ("Shift+ArrowRight", 3.1), ("ArrowLeft", 3.0)):
        slider.press(key)
        page.until(f"stationPage.playback.is_settled && Math.abs(stationPage.playback.time_s - {time_s}) < 1e-6")
    slider.press("End")
    page.until(f"stationPage.playback.is_settled && stationPage.playback.time_s > {episode.duration_s - 0.01}")
    slider.press("Home")
    page.until(f"stationPage.playback.is_settled && {PART} < 1e-6")
    assert "of 0:" in page.read("document.querySelector('#playback-slider').getAttribute('aria-valuetext')")
    box = slider.bounding_box()
    for act, part in ((page.tab.mouse.click, 0.25), (page.tab.touchscreen.tap, 0.75)):
        act(box["x"] + box["width"] * part, box["y"] + box["height"] / 2)
        page.until(f"stationPage.playback.is_settled && Math.abs({PART} - {part}) < 0.05")
    listed = page.read("[...document.querySelectorAll('#playback-jump option')].map(o => o.textContent)")
    told = [event for event in episode.manifest.events if event.name == "motion-start"]
    assert any("motion-start" in text for text in listed)
    assert len(page.read("[...document.querySelectorAll('#playback-marks i')].map(i => 1)")) == len(listed) - 1
    page.tab.select_option("#playback-jump", label=next(text for text in listed if "motion-start" in text))
    page.until(f"Math.abs(stationPage.playback.time_s - {told[0].at_s}) < 1e-6")


def test_nobody_takes_it_for_live_and_a_live_stop_is_taken_during_it(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = _play(open_page(_link(g1)))
    banner = page.tab.inner_text("#playback-title")
    assert "Episode" in banner
    assert banner.endswith("not live")
    assert page.read("[...document.querySelectorAll('.recorded')].every(e => e.checkVisibility())")
    live = page.read("stationPage.frames")
    page.until("document.querySelector('#robots .gate').textContent === 'waiting'")
    page.press_stop()
    g1.wait_for_gate("stopped")
    page.until("stationPage.stop.kind === 'stopped'")
    page.until("document.querySelector('#robots .gate').textContent === 'stopped'")
    assert page.read("stationPage.playback !== null")
    _go_to(page, 3.0)
    assert page.read("stationPage.frames")[f"robot:{ROBOT}"] == live[f"robot:{ROBOT}"], "live poses came meanwhile"
    page.tab.get_by_role("button", name="Back to live").click()
    page.until(f"stationPage.playback === null && stationPage.frames['robot:{ROBOT}'] > {live[f'robot:{ROBOT}']}")
    assert page.tab.is_hidden("#playback")
    assert page.read("[...document.querySelectorAll('.recorded')].every(e => !e.checkVisibility())")
    assert page.tab.locator("#camera-list figure").count() == 0
    wait_until(lambda: not players(g1.terminal.episode("wave")))
    g1.wait_again()


def test_a_player_goes_with_its_page_and_comes_back_with_its_console(g1: Standing, open_page: Open) -> None:
    folder = g1.terminal.episode("wave")
    console = g1.new_console("--name", "second")
    page = _play(open_page(console.links()["operator"]))
    _go_to(page, 3.25)
    assert len(players(folder)) == 1
    port = console.port
    console.kill()
    wait_until(lambda: not players(folder))
    g1.new_console("--name", "second", port=port)
    page.until("stationPage.link.is_up && stationPage.playback.is_settled && stationPage.playback.time_s === 3.25")
    wait_until(lambda: len(players(folder)) == 1)
    page.close()
    wait_until(lambda: not players(folder))


def test_what_cannot_be_played_is_said_in_a_line(g1: Standing, open_page: Open, tmp_path: Path) -> None:
    data = g1.terminal.data
    torn, broken, hostile = (EpisodeBuilder(data, task=task) for task in ("torn", "broken", "hostile"))
    for builder, seconds in ((torn, 1.0), (broken, 1.0), (hostile, 120.0)):  # the last one plays until it is paused
        walk(builder, seconds=seconds)
    torn.finish(torn=True)
    signals = broken.finish() / layout.SIGNALS
    signals.write_bytes(signals.read_bytes()[:300] + bytes(300))
    hostile.event(HOSTILE, at_s=1.2)
    events = [{"at_s": 0.5, "name": HOSTILE * 9, "severity": HOSTILE, "source": HOSTILE}]
    servers = {HOSTILE: {"robot": ROBOT, "robot_facts": {"model": HOSTILE}}}
    hostile.finish({"events": events * 300, "marks": [{"at_s": 0.6, "label": HOSTILE}], "servers": servers})
    page = open_page(_link(g1))
    try:
        for task in ("torn", "broken"):
            _open(page, task)
            page.until("stationPage.playback && stationPage.playback.error")
            note = page.tab.inner_text("#playback-note")
            assert note.startswith("It cannot be played: it was never finished; make it whole: station episodes repair")
            page.tab.get_by_role("button", name="Back to live").click()
            page.until("stationPage.playback === null")
        _play(page, "hostile")
        assert _go_to(page, 0.75)["note"] == ""
        assert "<img" in page.tab.inner_text("#playback-jump")
        assert page.read("window.hit === undefined && document.querySelectorAll('img[src=x]').length === 0")
    finally:
        for task in ("torn", "broken", "hostile"):
            shutil.rmtree(data / task)


def test_one_more_than_a_few_is_refused(g1: Standing, episode: Episode, open_page: Open) -> None:
    sockets = [g1.console.view() for _ in range(4)]
    try:
        for socket in sockets:
            socket.say(want=["play"], play={"episode": episode.id, "opened": 1})
            socket.frame()
        page = _open(open_page(_link(g1)), "wave")
        page.until("stationPage.playback && stationPage.playback.error")
        assert "4 episodes are being played already" in page.tab.inner_text("#playback-note")
    finally:
        for socket in sockets:
            socket.close()
    wait_until(lambda: not players(g1.terminal.episode("wave")))


@pytest.mark.parametrize("size", [DESKTOP, PHONE, SMALL], ids=str)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everybody_can_use_it_and_the_stop_stays_in_view(
    g1: Standing, open_page: Open, size: tuple[int, int], scheme: str
) -> None:
    page = _play(open_page(_link(g1), size, color_scheme=scheme, bypass_csp=True, reduced_motion="reduce"))
    _go_to(page, 3.0)
    assert page.violations() == []
    assert page.read("document.documentElement.scrollWidth <= innerWidth + 1")
    box = page.tab.locator("#stop").bounding_box()
    assert box["y"] + box["height"] <= size[1]
    for control in ("title", "live", "play", "slider", "speed", "jump", "time"):
        box = page.tab.locator(f"#playback-{control}").bounding_box()
        assert box["x"] >= 0, control
        assert box["x"] + box["width"] <= size[0], control
    page.tab.locator("#stop").focus()
    reached = set()
    for _ in range(80):
        page.tab.keyboard.press("Tab")
        reached.add(page.read("document.activeElement.id"))
    assert {f"playback-{control}" for control in ("live", "play", "slider", "speed", "jump")} <= reached


def test_the_recorded_robot_is_drawn_in_3d(g1: Standing, open_drawn: Open) -> None:
    page = _play(open_drawn(_link(g1)))
    drawn = page.read("stationPage.drawn.scene")
    _go_to(page, 4.0)
    page.until(f"stationPage.drawn.scene > {drawn}")
    assert page.tab.inner_text("#view-words") == ""
    assert page.tab.inner_text("#view-age") == "at 0:04.00"
