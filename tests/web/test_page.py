"""The page in a real browser, of a real station: C1 to C16 of the console's promises, by their numbers."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.life import estop, events
from tests.main_job.station_runs import Terminal
from tests.waiting import bus_answers, wait_until
from tests.web.browser import DESKTOP, PHONE, SMALL, TABLET, Page
from tests.web.conftest import Open, StartConsole
from tests.web.console_process import ConsoleProcess
from tests.web.random_faults import Faults
from tests.web.standing import GATE, ROBOT, Standing

pytest.importorskip("starlette", reason="needs the extra 'console'")

HOSTILE = '<img src=x onerror="window.hit=1"><script>window.hit=1</script>'
PAGE = Path(__file__).parents[2] / "station/web/page"


@pytest.fixture(scope="module")
def g1(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Standing]:
    """A station that the tests of this module share."""
    with contextlib.closing(Standing(tmp_path_factory.mktemp("w") / "w")) as made:
        yield made


def _operator(console: ConsoleProcess) -> str:
    return console.links()["operator"]


def test_c1_a_press_stops_the_robot_and_a_release_is_held(g1: Standing, open_page: Open) -> None:
    page = open_page(_operator(g1.console)).ready()
    for _ in range(2):
        g1.wait_again()
        page.until("stationPage.stop.kind === 'ready'")
        page.press_stop()
        g1.wait_for_gate("stopped")
        page.until("stationPage.stop.kind === 'stopped'")
        assert "g1" in page.read("stationPage.stop.word")
        page.hold("#stop-release button", 0.5)  # not long enough
        assert g1.gate() == "stopped"
        page.hold("#stop-release button", 2.4)
        page.until("stationPage.stop.kind === 'ready'")
        assert estop.latched(g1.bus.read(estop.KEYS).get) is None


def test_c1_a_viewer_stops_and_releases_nothing(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(g1.console.links()["viewer"], PHONE, has_touch=True).ready()
    page.tab.touchscreen.tap(*_middle(page, "#stop"))
    g1.wait_for_gate("stopped")
    page.until("stationPage.stop.kind === 'stopped'")
    assert not page.tab.locator("#stop-release button").is_visible()


def test_c1_a_key_stops_from_anywhere(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(_operator(g1.console)).ready()
    page.tab.locator("#take-task").focus()
    page.tab.keyboard.press("Control+.")
    g1.wait_for_gate("stopped")


def test_c4_a_press_on_a_frozen_console_is_not_taken_and_then_it_is(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(_operator(g1.console)).ready()
    g1.console.freeze()
    try:
        page.press_stop()
        page.until("stationPage.stop.kind === 'not-taken'")
        assert "robot" in page.read("stationPage.stop.word")
        assert g1.gate() != "stopped"
    finally:
        g1.console.thaw()
    g1.wait_for_gate("stopped")
    page.until("stationPage.stop.kind === 'stopped'")


def test_c4_c6_a_press_outlives_a_console_that_was_killed_and_a_link_that_is_void(
    g1: Standing, open_page: Open
) -> None:
    g1.wait_again()
    console = g1.new_console("--name", "second")
    page = open_page(_operator(console)).ready()
    port = console.port
    console.kill()
    page.press_stop()
    page.until("stationPage.stop.kind === 'not-taken'")
    g1.new_console("--name", "third", "--new-links", port=port)
    g1.wait_for_gate("stopped")
    page.until("stationPage.stop.is_taken")


def test_c7_a_page_says_that_it_hears_nothing_and_then_equals_a_fresh_one(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(_operator(g1.console)).ready()
    page.until("stationPage.stop.kind === 'ready'")
    g1.console.freeze()
    page.until("!stationPage.link.is_up && stationPage.stop.kind === 'no-link'")
    g1.console.thaw()
    page.until("stationPage.link.is_up && stationPage.stop.kind === 'ready'")
    fresh = open_page(g1.console.links()["viewer"]).ready()
    shown = "JSON.stringify(stationPage.state.robots.map(r => [r.name, r.gate, r.arming, r.state]))"
    assert page.read(shown) == fresh.read(shown)
    servers = "stationPage.state.servers.map(s => s.name).sort().join()"
    assert page.read(servers) == fresh.read(servers)


def test_what_came_before_a_panel_was_there_is_shown_though_the_line_was_silent_meanwhile(
    g1: Standing, open_page: Open
) -> None:
    page = open_page(_operator(g1.console)).ready()
    count = "document.querySelector('#episodes-count').textContent"
    shown = page.until(count)
    held: list[Any] = []
    came: list[str] = []
    page.context.route("**/page/episodes.js", lambda route: held.append(route))  # noqa: PLW0108  playwright marks it
    page.tab.on("websocket", lambda line: line.on("framereceived", lambda data: came.append(str(data)[:40])))
    page.tab.reload(wait_until="commit")
    wait_until(lambda: page.read("true") and any('"episodes"' in words for words in came))
    g1.console.freeze()
    page.until("window.stationPage && !stationPage.link.is_up")
    g1.console.thaw()
    page.until("stationPage.link.is_up")
    assert page.read(count) == "", "there is a panel already"
    held.pop().continue_()
    page.until(f"{count} === {shown!r}")


def test_c10_hostile_words_run_nothing(start_console: StartConsole, bus: Bus, open_page: Open) -> None:
    page = open_page(_operator(start_console())).ready()
    nan = codec.json_object({"state": HOSTILE, "reason": HOSTILE, "arming": HOSTILE})
    bus.publish({f"action_{HOSTILE}": b"\xff" * 4096, f"camera_image_{HOSTILE}": HOSTILE.encode(), GATE: nan,
                 keys.RECORDER: HOSTILE.encode(), keys.RUNBOOK: HOSTILE.encode()})  # fmt: skip
    for number in range(300):
        bus.publish({keys.EVENT: events.make(HOSTILE, f"{HOSTILE}{number}", "error", note=HOSTILE * 50).encode()})
        bus.publish({f"action_{HOSTILE}_{number}": b"1"})
    page.until("document.body.textContent.includes('<img src=x')")
    assert page.read("window.hit === undefined && document.querySelectorAll('img[src=x]').length === 0")
    page.press_stop()
    page.until("stationPage.stop.is_taken")


@pytest.mark.parametrize("size", [DESKTOP, TABLET, PHONE, SMALL], ids=str)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_c13_the_stop_is_in_view_and_everybody_can_use_the_page(
    g1: Standing, open_page: Open, size: tuple[int, int], scheme: str
) -> None:
    page = open_page(_operator(g1.console), size, color_scheme=scheme, bypass_csp=True, reduced_motion="reduce").ready()
    page.until("stationPage.state.robots.length")
    page.tab.mouse.wheel(0, 4000)
    box = page.tab.locator("#stop").bounding_box()
    assert min(box["width"], box["height"]) >= 44
    assert box["y"] + box["height"] <= size[1]
    assert box["x"] + box["width"] <= size[0]
    assert page.read("document.documentElement.scrollWidth <= innerWidth + 1")
    assert page.violations() == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_c13_what_is_old_can_be_read_too(g1: Standing, open_page: Open, scheme: str) -> None:
    g1.wait_again()
    page = open_page(
        _operator(g1.console), DESKTOP, color_scheme=scheme, bypass_csp=True, reduced_motion="reduce"
    ).ready()
    page.until("stationPage.state.robots.length")
    g1.console.freeze()
    try:
        page.until("stationPage.stop.kind === 'no-link' && document.querySelectorAll('#robots .old').length")
        assert page.violations() == []
    finally:
        g1.console.thaw()


def test_c13_the_keyboard_reaches_everything(g1: Standing, open_page: Open) -> None:
    page = open_page(_operator(g1.console)).ready()
    page.until("stationPage.state.robots.length")
    reached = set()
    for _ in range(80):
        page.tab.keyboard.press("Tab")
        reached.add(page.read("document.activeElement.id || document.activeElement.textContent.trim().slice(0, 40)"))
    assert {"stop", "take-task", "theme"} <= reached
    missing = page.read(
        "[...document.querySelectorAll('button:enabled, input, summary')]"
        ".filter(e => e.checkVisibility() && e.tabIndex < 0).map(e => e.outerHTML)"
    )
    assert missing == []


def test_c13_without_webgl_the_rest_works(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page("about:blank")
    page.context.add_init_script(
        "OffscreenCanvas.prototype.getContext = () => null; HTMLCanvasElement.prototype.transferControlToOffscreen = "
        "undefined;"
    )
    page.tab.goto(_operator(g1.console))
    page.ready()
    page.press_stop()
    g1.wait_for_gate("stopped")
    page.until("stationPage.stop.kind === 'stopped'")


def test_c14_a_take_from_the_page_is_what_check_says(tmp_path: Path, processes: None, open_page: Open) -> None:
    terminal = Terminal(tmp_path / "t")
    station = terminal.start("up", "g1-sim-motion", "--yes", "--set", "motion.loop=true")
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: bus_answers(address) or station.poll() is not None)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in terminal.environment.items():
            patch.setenv(name, value)
        console = ConsoleProcess(address, tmp_path, "--set", f"data={terminal.data}")
    try:
        page = open_page(_operator(console)).ready()
        page.until("stationPage.state.robots.length && stationPage.state.robots[0].gate === 'tracking'")
        page.tab.fill("#take-task", "carry")
        _click(page, "Record")
        page.until("stationPage.state.recorder && stationPage.state.recorder.state === 'recording'")
        _click(page, "Mark")
        page.until("stationPage.state.recorder.messages > 500")
        _click(page, "Keep: success")
        page.until("stationPage.state.recorder.state === 'idle'")
        verdict = page.until("stationPage.state.takes.last", 180.0)
        told = terminal.json("check", "latest")
        assert verdict == told["verdict"]
        assert page.read("stationPage.state.takes.last_hour") == 1
        shown = json.loads(console.ask(f"/api/episode?id={told['episode_id']}")[1])
        figures = dict(map(tuple, shown["figures"]))
        for name in ("messages", "dropped", "falls"):
            assert figures[name] == str(told[name])
        assert terminal.json("episodes", "list")[0]["success"] is True
    finally:
        console.kill()
        station.send_signal(signal.SIGINT)
        station.communicate(timeout=60)


def test_c16_nothing_leaves_the_origin(g1: Standing, open_drawn: Open) -> None:
    page = open_drawn(_operator(g1.console)).ready()
    page.until("stationPage.drawn.scene > 5")
    strangers = [url for url in page.asked if not url.startswith((g1.console.origin, "blob:", "data:"))]
    assert strangers == []


def test_c16_vendored_files_are_what_their_list_says() -> None:
    files = json.loads((PAGE / "vendor/HASHES.json").read_text())
    assert {path.name for path in (PAGE / "vendor").iterdir()} == {"HASHES.json", *files}
    for name, facts in files.items():
        assert hashlib.sha256((PAGE / "vendor" / name).read_bytes()).hexdigest() == facts["sha256"], name
        assert facts["version"]
        assert facts["licence"]


def test_poses_are_drawn_and_pictures_are_not_waited_for(g1: Standing, open_drawn: Open) -> None:
    g1.wait_again()
    page = open_drawn(_operator(g1.console)).ready()
    page.until("stationPage.drawn.scene > 10")
    name = f"robot:{ROBOT}"
    first = page.read(f"stationPage.frames['{name}']")
    page.until(f"stationPage.frames['{name}'] > {first} + 10")


def _middle(page: Page, selector: str) -> tuple[float, float]:
    box = page.tab.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _click(page: Page, text: str) -> None:
    page.tab.get_by_role("button", name=text, exact=True).click()


REAL = """
runbook: beside-a-robot
description: people stand beside it
robot: unitree_g1_with_hands
robot_is_real: true
steps:
  - start: recorder
  - confirm: The robot hangs in its gantry.
"""


def test_c12_a_page_answers_what_the_runbook_asks_and_for_a_real_robot_it_is_held(
    tmp_path: Path, processes: None, open_page: Open
) -> None:
    (tmp_path / "real.yaml").write_text(REAL)
    terminal = Terminal(tmp_path / "t")
    arguments = ("--ask", "console", "--record", "--task", "held")
    station = terminal.start("up", str(tmp_path / "real.yaml"), *arguments)
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: bus_answers(address) or station.poll() is not None)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in terminal.environment.items():
            patch.setenv(name, value)
        console = ConsoleProcess(address, tmp_path)
    try:
        page = open_page(_operator(console), PHONE).ready()
        page.until("stationPage.state.runbook && stationPage.state.runbook.question")
        page.until("document.querySelector('#question-sentence').textContent.includes('gantry')")
        assert page.read("stationPage.state.runbook.question.hold_s") > 1.0
        page.hold("#question-answers button:has-text('yes')", 0.3)
        page.tab.wait_for_timeout(300)
        assert page.read("stationPage.state.runbook.question !== null")
        page.hold("#question-answers button:has-text('yes')", 1.8)
        page.until("stationPage.state.runbook.question === null")
    finally:
        console.kill()
        station.send_signal(signal.SIGINT)
        station.communicate(timeout=60)
    answers = open_episode(terminal.episode("held")).manifest.runbook["answers"]
    (given,) = (answer for answer in answers if "gantry" in answer["step"])
    assert given["answer"] == "yes"
    assert given["where"] == "console"
    assert "@127.0.0.1" in given["who"]


def test_a_stop_that_another_releases_at_once_is_no_stop_any_more(g1: Standing, open_page: Open) -> None:
    g1.wait_again()
    page = open_page(_operator(g1.console)).ready()
    page.until("stationPage.stop.kind === 'ready'")
    page.press_stop()
    g1.wait_for_gate("stopped")
    g1.wait_again()
    page.until("stationPage.stop.kind === 'ready'")


def test_c5_a_press_reaches_the_robot_past_a_dead_bus(tmp_path: Path, processes: None, open_page: Open) -> None:
    terminal = Terminal(tmp_path / "t")
    bus_process = terminal.start("bus", "start")
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: bus_answers(address))
    station = terminal.start("up", "g1-sim-motion", "--yes", "--set", "motion.loop=true")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in terminal.environment.items():
            patch.setenv(name, value)
        console = ConsoleProcess(address, tmp_path)
    log = next(iter(wait_for_logs(tmp_path / "t", "g1.log")))
    try:
        page = open_page(_operator(console)).ready()
        page.until("stationPage.state.robots.length && stationPage.state.robots[0].gate === 'tracking'")
        with Bus(address, name="test", timeout_s=5.0) as line:
            server = int(line.call("INFO", "server").decode().partition("process_id:")[2].split()[0])
        os.kill(server, signal.SIGSTOP)
        page.press_stop()
        wait_until(lambda: "to=stopped" in log.read_text())
        page.until("stationPage.stop.word.startsWith('told past the bus')")
        assert "g1" in page.read("stationPage.stop.more")
        os.kill(server, signal.SIGCONT)
        page.until("stationPage.stop.is_taken")
    finally:
        console.kill()
        for process in (station, bus_process):
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)


def test_after_faults_in_any_order_the_page_says_what_is_true(g1: Standing, browser: Any) -> None:
    g1.wait_again()
    with contextlib.closing(Faults(g1, browser, seed=7)) as faults:
        for _ in range(12):
            faults.act()
            faults.wait_for_right_words()
        faults.heal()
        faults.wait_for_right_words()
        faults.page.until("stationPage.stop.is_taken || stationPage.stop.id === ''")
        assert faults.presses
        assert faults.page.trouble == []


def wait_for_logs(folder: Path, name: str) -> list[Path]:
    """Return the files of a name in a folder, as soon as there are any."""
    found: list[Path] = []

    def are_there() -> bool:
        found[:] = folder.rglob(name)
        return bool(found)

    wait_until(are_there)
    return found
