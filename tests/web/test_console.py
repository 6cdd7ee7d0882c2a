"""The console as a process on a real bus, seen by pages without a browser."""

from __future__ import annotations

import json
import os
import signal
import ssl
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.life import estop, events
from station.life.server import Health
from station.life.stop_file import StopFile
from station.web.keyring import Keyring
from tests import strider
from tests.web.conftest import StartConsole
from tests.web.console_process import ConsoleProcess, PageSocket

pytest.importorskip("starlette", reason="needs the extra 'console'")

Keep = Callable[[PageSocket], PageSocket]

HOSTILE = '<img src=x onerror="window.hit=1"><script>window.hit=1</script>'


def _walk(bus: Bus, number: int = 1, gate: str = "tracking") -> None:
    """Write a step of a robot that nothing of ours knows, and what its server says of itself."""
    q = np.array([0.1, -0.2]) * number
    health = Health(name="walker", role="low-level", state="active", pid=1, host="elsewhere", boot="b00t", source="w",
                    started_wall_ns=1, wall_ns=time.time_ns())  # fmt: skip
    told = strider.step(number, q) | {
        keys.robot_state(strider.NAME): strider.state(q),
        keys.command_gate(strider.NAME): codec.json_object({"state": gate, "reason": "", "arming": "armed"}),
        keys.server("walker"): codec.json_object(health),
        keys.server_config("walker"): codec.json_object(strider.facts()),
    }
    assert bus.publish(told)


@pytest.fixture
def walker(bus: Bus) -> Iterator[list[str]]:
    """A robot that goes on; the list holds what its gate says."""
    gate, over = ["tracking"], threading.Event()

    def go() -> None:
        number = 0
        while not over.wait(0.02):
            number += 1
            _walk(bus, number % 5, gate[0])

    thread = threading.Thread(target=go)
    thread.start()
    yield gate
    over.set()
    thread.join()


def test_a_page_is_told_of_a_station_whole(start_console: StartConsole, walker: list[str], closing: Keep) -> None:
    page = closing(start_console().page())
    state = page.state(lambda state: state["robots"] and state["robots"][0]["rate_hz"])
    robot = state["robots"][0]
    assert (robot["name"], robot["server"], robot["gate"], robot["arming"]) == (
        strider.NAME, "walker", "tracking", "armed",
    )  # fmt: skip
    assert robot["age_s"] < 1.0
    assert state["bus"]["linked"]
    assert state["stop"] is None
    assert {"walker", "console"} <= {server["name"] for server in state["servers"]}
    listed = page.until(lambda said: said["t"] == "keys" and said["keys"])["keys"]
    assert keys.robot_state(strider.NAME) in {item["key"] for item in listed}


def test_one_who_joins_late_is_told_the_same(start_console: StartConsole, walker: list[str], closing: Keep) -> None:
    console = start_console()
    first = closing(console.page())
    first.state(lambda state: state["robots"])
    walker[0] = "holding"
    seen = first.state(lambda state: state["robots"][0]["gate"] == "holding")
    late = closing(console.page("viewer")).state()
    assert late["robots"][0]["gate"] == seen["robots"][0]["gate"] == "holding"
    assert any("holding" in alarm["text"] for alarm in late["alarms"])


def test_poses_come_one_at_a_time(start_console: StartConsole, walker: list[str], closing: Keep) -> None:
    console = start_console()
    closing(console.page()).state(lambda state: state["robots"])
    scene = json.loads(console.ask(f"/api/scene?robot={strider.NAME}")[1])
    assert scene["joints"] == list(strider.KNEES)
    assert scene["shapes"] == []
    assert "not drawn" in scene["note"]
    view, feed = closing(console.view()), f"robot:{strider.NAME}"
    view.say(want=[feed])
    for _ in range(3):
        header, payload = view.frame()
        assert (header["f"], header["has_pose"], header["gate"]) == (feed, False, "tracking")
        measured, asked = np.frombuffer(payload, "<f4").reshape(2, -1)
        np.testing.assert_allclose(measured, asked, atol=1e-6)
        with pytest.raises(TimeoutError):
            view.frame(0.2)  # before it has said that it used the last one
        view.say(got=feed)


def test_a_stop_is_taken_by_socket_and_by_post(start_console: StartConsole, bus: Bus, closing: Keep) -> None:
    console = start_console()
    page, key = closing(console.page("viewer")), console.stop_key()
    page.say(t="stop", id="first", key=key, reason="test")
    said = page.until(lambda said: said["t"] == "stop")
    assert (said["id"], said["said"]) == ("first", "taken")
    assert estop.latched(bus.read(estop.KEYS).get) is not None
    page.state(lambda state: state["stop"] is not None, 2.0)

    body = json.dumps({"id": "second", "reason": "test"}).encode()
    status, answer = console.ask("/stop", body=body, X_Station_Stop=key)
    assert (status, json.loads(answer)["said"]) == (200, "taken")
    status, _ = console.ask("/stop", body=body, X_Station_Stop="another")
    assert status == 403
    refused = page.ask("release")  # a viewer stops, and releases nothing
    assert not refused["ok"]
    assert "viewer" in refused["text"]
    assert estop.latched(bus.read(estop.KEYS).get) is not None

    operator = closing(console.page("operator"))
    assert operator.ask("release")["ok"]
    operator.state(lambda state: state["stop"] is None)


def test_one_press_is_one_write_however_often_it_comes(start_console: StartConsole, bus: Bus, closing: Keep) -> None:
    console = start_console()
    page, key = closing(console.page()), console.stop_key()
    for _ in range(20):
        page.say(t="stop", id="one", key=key)
    for _ in range(20):
        assert page.until(lambda said: said["t"] == "stop")["said"] == "taken"
    page.say(t="stop", id="one", key=key)  # that was on its way when the first was answered
    assert page.until(lambda said: said["t"] == "stop")["said"] == "taken"
    sample = bus.read(estop.KEYS).get(estop.KEYS[0]) or bus.read(estop.KEYS)[estop.KEYS[1]]
    assert sample.stamp is not None
    assert sample.stamp.seq == 1


def test_the_stop_outlives_links_and_a_restart(start_console: StartConsole, bus: Bus, closing: Keep) -> None:
    first = start_console()
    key, cookie, port = first.stop_key(), first.cookie(), first.port
    first.kill()
    second = start_console("--new-links", port=port)
    with pytest.raises(InvalidStatus):
        second.page(cookie=cookie)
    assert second.ask("/api/me", cookie=cookie)[0] == 401
    body = json.dumps({"id": "late", "reason": "test"}).encode()
    assert second.ask("/stop", body=body, cookie="", X_Station_Stop=key)[0] == 200
    assert estop.latched(bus.read(estop.KEYS).get) is not None


def _typed(console: ConsoleProcess, code: str) -> int:
    return console.ask("/pair", body=json.dumps({"code": code}).encode(), cookie="nothing=1")[0]


def test_a_code_lets_a_browser_in_as_the_operator(start_console: StartConsole) -> None:
    console = start_console()
    page = console.ask("/", cookie="nothing=1")
    assert page[0] == 401
    assert b"station pair" in page[1]
    code = Keyring().code(time.time())
    assert _typed(console, f" {code[:4]} {code[4:]}") == 200
    assert _typed(console, "") == 403
    assert console.ask("/pair", body=b"[1]", cookie="nothing=1")[0] == 403
    assert console.ask("/pair", body=json.dumps({"code": code}).encode(), origin="http://127.0.0.1:1")[0] == 403


def test_who_guesses_codes_is_stopped(start_console: StartConsole) -> None:
    console = start_console()
    told = [_typed(console, f"{number:08}") for number in range(12)]
    assert told[:10] == [403] * 10
    assert told[10:] == [429, 429]
    assert _typed(console, Keyring().code(time.time())) == 429


def test_pair_prints_what_lets_a_browser_in(start_console: StartConsole, bus_server: BusAddress) -> None:
    console = start_console()
    page = console.page()
    page.state()
    told = subprocess.run([sys.executable, "-m", "station", "pair", "--bus", bus_server.url], capture_output=True,
                          text=True, check=True).stdout  # fmt: skip
    page.close()
    first, code, link = told.splitlines()
    assert first == f"console: {console.origin}/"
    assert _typed(console, code.split("code ")[1].split("  (")[0]) == 200
    assert link == f"  link {console.links()['operator']}"


def test_pair_says_that_there_is_no_page(bus_server: BusAddress, processes: None) -> None:
    told = subprocess.run([sys.executable, "-m", "station", "pair", "headset", "--bus", bus_server.url],
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert told.returncode == 1
    assert told.stderr.startswith("station: no server 'headset' serves a page on ")
    assert "start one: `station console`, or a runbook with a webxr server" in told.stderr


@pytest.mark.parametrize(
    "wrong",
    [
        {"origin": "http://127.0.0.1:1"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"host": "evil.example"},
        {"x_station": "0"},
        {"content_type": "text/plain"},
    ],
    ids=str,
)
def test_another_page_presses_nothing(start_console: StartConsole, bus: Bus, wrong: dict[str, str]) -> None:
    console = start_console()
    body = json.dumps({"id": "foreign", "reason": "test"}).encode()
    assert console.ask("/stop", body=body, X_Station_Stop=console.stop_key(), **wrong)[0] == 403
    assert estop.latched(bus.read(estop.KEYS).get) is None


def test_another_page_hears_nothing(start_console: StartConsole) -> None:
    console = start_console()
    for path in ("/ws/news", "/ws/view"):
        with pytest.raises(InvalidStatus):
            PageSocket(console, path, console.cookie(), origin="http://127.0.0.1:1")
        with pytest.raises(InvalidStatus):
            PageSocket(console, path, "nothing=1")
    for path in ("/api/me", "/api/scene?robot=x", "/api/episode?id=x", "/"):
        assert console.ask(path, cookie="nothing=1")[0] == 401
    assert console.ask("/", host="evil.example")[0] == 403


def test_a_page_is_told_when_the_bus_goes_and_comes(
    start_console: StartConsole, own_bus: RedisServer, closing: Keep
) -> None:
    console = start_console(address=own_bus.address)
    page = closing(console.page())
    page.state(lambda state: state["bus"]["linked"])
    os.kill(own_bus.pid, signal.SIGSTOP)
    lost = page.state(lambda state: not state["bus"]["linked"])
    assert lost["alarms"][0]["level"] == "error"
    page.say(t="stop", id="dead", key=console.stop_key())
    os.kill(own_bus.pid, signal.SIGCONT)
    page.state(lambda state: state["bus"]["linked"])


def test_a_stop_that_no_bus_takes_is_said_not_to_be(start_console: StartConsole, closing: Keep, tmp_path: Any) -> None:
    nowhere = BusAddress(socket=str(tmp_path / "nothing.sock"))
    console = start_console(address=nowhere)
    page = closing(console.page())
    state = page.state()
    assert not state["bus"]["linked"]
    assert "nothing.sock" in state["bus"]["reason"]
    page.say(t="stop", id="dead", key=console.stop_key())
    said = page.until(lambda said: said["t"] == "stop")
    assert said["said"] == "not-taken"
    assert StopFile(nowhere).read() is not None  # nothing starts under it


def test_hostile_words_are_text(start_console: StartConsole, bus: Bus, closing: Keep) -> None:
    console = start_console()
    page = closing(console.page())
    page.state(lambda state: state["bus"]["linked"])
    bus.publish({f"action_{HOSTILE}": b"\xff\x00" * 100, keys.RECORDER: b"\xff", keys.RUNBOOK: HOSTILE.encode(),
                 keys.server(HOSTILE): b"{}", keys.server_config(HOSTILE): b"[" * 5000})  # fmt: skip
    bus.publish({keys.EVENT: events.make(HOSTILE, HOSTILE + "\x1b[2J", "error", note=HOSTILE * 100).encode()})
    event = page.until(lambda said: said["t"] == "event" and not said.get("is_old"))
    assert "\x1b" not in json.dumps(event, ensure_ascii=False)
    assert len(event["text"]) < 1000
    listed = page.until(lambda said: said["t"] == "keys" and any("<img" in item["key"] for item in said["keys"]))
    assert all(len(item["key"]) < 400 for item in listed["keys"])
    page.state()


def test_ten_thousand_keys_are_no_trouble(start_console: StartConsole, bus: Bus, closing: Keep) -> None:
    for start in range(0, 10_000, 500):
        bus.publish({f"action_invented_{number}": b"1" for number in range(start, start + 500)})
    page = closing(start_console().page())
    listed = page.until(lambda said: said["t"] == "keys" and said["keys"])
    assert len(listed["keys"]) == 500
    assert page.state()["bus"]["linked"]


@pytest.mark.parametrize(
    "said",
    [
        "",
        "nothing",
        "[1]",
        '{"t": 5}',
        '{"t": "ask"}',
        '{"t": "ask", "id": [], "what": "arm"}',
        '{"t": "ask", "id": "1", "what": "fly"}',
        "[" * 5000,
    ],
)
def test_a_page_that_says_nonsense_is_answered_or_passed_over(
    start_console: StartConsole, closing: Keep, said: str
) -> None:
    page = closing(start_console().page())
    page.socket.send(said)
    page.say(t="ping", id=7)
    assert page.until(lambda told: told["t"] == "pong")["id"] == 7


def test_only_who_has_the_desk_asks(start_console: StartConsole, closing: Keep) -> None:
    console = start_console()
    first, second = closing(console.page()), closing(console.page())
    first.state(lambda state: state["desk"]["is_mine"])
    assert "the desk is with" in second.ask("record.start", task="x")["text"]
    assert second.ask("desk.take")["ok"]
    assert first.state(lambda state: not state["desk"]["is_mine"])["desk"]["viewers"] == 2
    answer = second.ask("record.start", task="x")
    assert not answer["ok"]
    assert "recorder" in answer["text"]  # none runs here
    second.close()
    first.state(lambda state: state["desk"]["holder"] == "")
    first.ask("record.mark")
    first.state(lambda state: state["desk"]["is_mine"])


def test_a_message_that_no_page_of_ours_sends_costs_its_line(start_console: StartConsole, closing: Keep) -> None:
    console = start_console()
    page = closing(console.page())
    page.socket.send("x" * (1 << 20))
    with pytest.raises(ConnectionClosed):
        page.until(lambda said: False)
    closing(console.page()).state()
    status, _ = console.ask("/stop", body=b"x" * (1 << 20), X_Station_Stop=console.stop_key())
    assert status in (0, 403)


def test_ctrl_c_ends_it_with_code_zero(start_console: StartConsole, closing: Keep) -> None:
    console = start_console()
    closing(console.page()).state()
    console.process.send_signal(2)
    assert console.process.wait(20) == 0
    assert "Traceback" not in console.words()


@pytest.fixture
def own_bus(processes: None, tmp_path: Any) -> Iterator[RedisServer]:
    """A bus that may be frozen."""
    with RedisServer.start(ServerOptions(socket=tmp_path / "own.sock", folder=tmp_path)) as server:
        yield server


def test_for_other_machines_it_speaks_tls_and_shows_a_link_to_photograph(start_console: StartConsole) -> None:
    console = start_console("--host", "0.0.0.0")
    words = console.words()
    assert "█" in words
    authority = words.partition("authority: ")[2].splitlines()[0]
    context = ssl.create_default_context(cafile=authority)
    page = f"https://127.0.0.1:{console.port}"
    with urllib.request.urlopen(f"{page}/page/index.html", context=context, timeout=20) as answer:
        assert answer.status == 200
    token = console.links()["operator"].partition("token=")[2]

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_: object) -> None:
            return None

    opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=context), Stay)
    with pytest.raises(urllib.error.HTTPError) as found:
        opener.open(f"{page}/?token={token}", timeout=20)
    cookie = found.value.headers["set-cookie"]
    assert found.value.code == 303
    assert cookie.startswith("__Host-station-")
    assert {"Secure", "HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
    found.value.close()


@pytest.mark.parametrize("held", [None, "nothing"])
def test_a_certificate_that_is_none_is_named(processes: None, tmp_path: Any, held: str | None) -> None:
    for name in ("page.pem", "page.key"):
        if held is not None:
            (tmp_path / name).write_text(held)
    command = [sys.executable, "-m", "station", "console", "--port", "0", "--set", f"certificate={tmp_path}/page.pem",
               "--set", f"key={tmp_path}/page.key"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "page.pem" in line
    assert "PEM" in line


def test_it_stays_when_a_station_ends_and_shows_the_next_one(
    start_console: StartConsole, closing: Keep, tmp_path: Any
) -> None:
    options = ServerOptions(socket=tmp_path / "own.sock", folder=tmp_path)
    with RedisServer.start(options) as first, Bus(first.address, name="walker", timeout_s=5.0) as bus:
        _walk(bus)
        page = closing(start_console(address=first.address).page())
        page.state(lambda state: state["robots"] and state["bus"]["linked"])
    gone = page.state(lambda state: not state["bus"]["linked"])
    assert "no station runs" in gone["bus"]["reason"] or "does a station run there" in gone["bus"]["reason"]
    assert all("silent" not in alarm["text"] for alarm in gone["alarms"])  # of servers nothing is known now
    with RedisServer.start(options) as second, Bus(second.address, name="walker", timeout_s=5.0) as bus:
        _walk(bus, gate="holding")
        page.state(lambda state: state["bus"]["linked"] and state["robots"] and state["robots"][0]["gate"] == "holding")
