"""Alarms that are heard: what the page did about each, in a real browser."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

import pytest

from station.bus import keys
from station.life import events
from tests.web.conftest import Open
from tests.web.standing import Standing

pytest.importorskip("starlette", reason="needs the extra 'console'")

FALLS = "document.querySelectorAll('#event-list li[title=fall]').length"


@pytest.fixture(scope="module")
def g1(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Standing]:
    """A robot that stands."""
    with contextlib.closing(Standing(tmp_path_factory.mktemp("w") / "w")) as made:
        yield made


def test_alarms_are_silent_until_somebody_wants_them(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(g1.console.links()["operator"]).ready()
    assert page.tab.inner_text("#sound") == "sound off"
    page.press_stop()
    page.until("stationPage.stop.kind === 'stopped'")
    assert page.read("[stationPage.sound.error, stationPage.sound.stop, stationPage.sound.vibrated]") == [0, 0, 0]


def test_each_new_alarm_sounds_once_and_stopped_as_nothing_else(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(g1.console.links()["operator"], has_touch=True).ready()
    page.until("stationPage.stop.kind === 'ready'")
    page.tab.click("#sound")
    page.until("stationPage.sound.is_awake && stationPage.sound.ended === 1")  # it lets itself be heard
    assert page.tab.inner_text("#sound") == "sound on"
    falls = page.read(FALLS)
    page.press_stop()
    page.until("stationPage.stop.kind === 'stopped' && stationPage.sound.stop === 1")
    stood_s = page.read("stationPage.state.alarms[0].since_s")
    page.until(f"stationPage.state.alarms[0].since_s > {stood_s + 1.5}")
    assert page.read("stationPage.sound.stop") == 1, "it sounds for as long as the alarm stands"
    g1.bus.publish({keys.EVENT: events.make("fall", "g1", "error", tilt_rad=1.2).encode()})
    page.until(f"{FALLS} > {falls} && stationPage.sound.error === 1 + {FALLS} - {falls}")  # damped, it falls of itself
    page.until("stationPage.sound.ended === stationPage.sound.error + stationPage.sound.stop")
    page.until("stationPage.sound.vibrated >= 2")
    page.tab.reload()
    page.ready()
    assert page.tab.inner_text("#sound") == "touch for sound"
    page.tab.locator("#take-task").click()
    page.until("document.querySelector('#sound').textContent === 'sound on'")
    # What stood before the page came is no news.
    assert page.read("[stationPage.sound.error, stationPage.sound.stop]") == [0, 0], page.read(
        "stationPage.sound.newest"
    )


def test_a_link_that_is_lost_sounds(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(g1.console.links()["viewer"]).ready()
    page.until("stationPage.link.is_up")
    page.tab.click("#sound")
    before = page.read("stationPage.sound.error")
    g1.console.process.send_signal(signal.SIGSTOP)
    try:
        page.until(f"stationPage.sound.error === {before + 1}")
    finally:
        g1.console.thaw()
