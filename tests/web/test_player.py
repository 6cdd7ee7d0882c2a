"""An episode that is played: what is shown at an instant is what the episode holds there."""

from __future__ import annotations

import json
import math
import os
import signal
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from station.api.episode import open_episode
from station.bus import codec, keys
from station.episode.reading import reader
from station.episode.storage import layout
from station.errors import EpisodeError
from station.web.player import CAMERA, EPISODE, PLAY, ROBOT, SCENE, Order, Player
from tests import strider
from tests.episode.synthetic import STANDING, EpisodeBuilder, tick
from tests.waiting import DEADLINE_S, wait_until
from tests.web.conftest import StartConsole
from tests.web.console_process import ConsoleProcess, PageSocket, players

pytest.importorskip("starlette", reason="needs the extra 'console'")

Shown = dict[str, tuple[dict[str, Any], bytes]]
Build = Callable[[EpisodeBuilder], None]

G1 = "unitree_g1_with_hands"
SECONDS = 40.0


def _picture(number: int) -> bytes:
    return b"\xff\xd8%06d\xff\xd9" % number


def _walk(builder: EpisodeBuilder, seconds: float = SECONDS) -> None:
    """A robot that bends its joints, and a camera that looks on from the first second on."""
    for number in range(round(seconds * 50)):
        tick(builder, number, at_s=0.1 + number / 50, q=STANDING + 0.2 * math.sin(number / 40))
        if number >= 50 and number % 5 == 0:
            builder.write({keys.camera_image("head"): _picture(number)}, at_s=0.1 + number / 50, writer="head")
        if number % 500 == 0:
            builder.event("motion-start", at_s=0.1 + number / 50)


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An episode of 40 s."""
    builder = EpisodeBuilder(tmp_path_factory.mktemp("d") / "data")
    _walk(builder)
    events = [{"at_s": 10.1, "name": "motion-start", "severity": "info", "source": "motion"}]
    marks = [{"at_s": 3.0, "label": "grasp"}]
    return builder.finish({"timing": {"duration_s": 39.5}, "events": events, "marks": marks})


class Watched:
    """A player, and what a page that takes every frame at once has of it."""

    def __init__(self, folder: Path) -> None:
        self.player = Player(reader.open_episode(folder), 0.0)
        self.now_s = 0.0
        self.has: Shown = {}
        self.step(0.0)

    def step(self, seconds: float) -> Shown:
        """Let so much time go by; return what came."""
        self.now_s += seconds
        came = {frame.facts["f"]: (dict(frame.facts), frame.payload) for frame in self.player.step(self.now_s)}
        self.has |= came
        for feed in came:
            self.player.obey(Order(got=feed))
        return came

    def do(self, **order: Any) -> Shown:
        """Obey an order."""
        self.player.obey(Order(**order))
        return self.step(0.0)

    def json(self, feed: str) -> Any:
        return json.loads(self.has[feed][1])

    def told(self) -> dict[str, Any]:
        return self.has[PLAY][0]

    def rows(self) -> Any:
        """Instants, joints measured and joints asked of the newest frame of the robot, shapes (n,), (n, m), (n, m)."""
        facts, payload = self.has[ROBOT]
        scene = self.json(SCENE)
        poses = 7 * len(scene["bodies"]) * (facts["has_pose"] + facts["has_ghost"])
        joints = len(scene["joints"])
        numbers = np.frombuffer(payload, "<f4")[poses + 2 * joints :].reshape(facts["rows"], 4 + 2 * joints)
        return facts["time_s"] + numbers[:, 0], numbers[:, 4 : 4 + joints], numbers[:, 4 + joints :]


def _at(folder: Path, key: str, time_s: float, *columns: str) -> Any:
    """What a script reads of a key at an instant: the newest row that had arrived."""
    table = open_episode(folder).numpy(key, *columns)
    return table.values[int(np.searchsorted(table.time_s, time_s, side="right")) - 1]


def test_what_is_shown_is_what_a_script_reads_at_that_instant(walked: Path) -> None:
    page = Watched(walked)
    joints = [f"{name}_pos" for name in page.json(SCENE)["joints"]]
    assert len(joints) == len(G1_29)
    pictures = list(open_episode(walked).raw(keys.camera_image("head")))
    for time_s in (12.0, 0.5, 30.333, 12.01, 39.5, 12.0):
        page.do(time_s=time_s)
        assert page.told()["time_s"] == page.has[ROBOT][0]["time_s"] == time_s
        at_s, measured, asked = page.rows()
        assert at_s[-1] == pytest.approx(time_s)
        np.testing.assert_array_equal(measured[-1], _at(walked, keys.sim_qpos(G1), time_s, *joints).astype("f4"))
        np.testing.assert_array_equal(asked[-1], _at(walked, keys.command_used(G1), time_s, *joints).astype("f4"))
        newest = [(at, data) for at, data in pictures if at <= time_s]
        assert page.told()["pictures"]["head"] == (pytest.approx(newest[-1][0]) if newest else None)
        if newest:
            assert page.has[f"{CAMERA}head"][1] == newest[-1][1]


def test_it_says_what_the_episode_is(walked: Path) -> None:
    told = Watched(walked).json(EPISODE)
    assert told["length_s"] == open_episode(walked).duration_s == 39.5
    assert (told["robots"], told["cameras"]) == ([G1], ["head"])
    assert [(event["at_s"], event["text"], event["kind"]) for event in told["events"]] == [
        (3.0, "mark grasp", "mark"), (10.1, "motion-start", "info"),
    ]  # fmt: skip


def test_time_goes_as_fast_as_it_is_asked_to_and_stands_in_a_pause(walked: Path) -> None:
    page = Watched(walked)
    page.step(1.0)
    assert page.told()["time_s"] == 0.0
    page.do(is_playing=True)
    for speed in (1.0, 4.0, 0.25):
        before_s = page.told()["time_s"]
        page.do(speed=speed)
        for _ in range(30):
            page.step(1 / 30)
        assert page.told()["time_s"] - before_s == pytest.approx(speed)
    page.do(is_playing=False)
    before_s = page.told()["time_s"]
    assert page.step(0.2) == {}
    assert page.step(2.0)[PLAY][0]["time_s"] == before_s  # only to say that it is there


def test_it_ends_at_its_end_and_begins_again(walked: Path) -> None:
    page = Watched(walked)
    page.do(time_s=39.4, is_playing=True)
    page.step(0.2)
    assert (page.told()["time_s"], page.told()["is_playing"]) == (39.5, False)
    page.do(is_playing=True)
    assert (page.told()["time_s"], page.told()["is_playing"]) == (0.0, True)
    page.do(time_s=1e9)
    assert page.told()["time_s"] == 39.5
    page.do(time_s=-1e9)
    assert page.told()["time_s"] == page.json(EPISODE)["start_s"]


def test_rows_follow_each_other_while_it_plays_and_reach_back_after_a_jump(walked: Path) -> None:
    page = Watched(walked)
    page.do(time_s=30.0, is_playing=True, speed=4.0)
    at_s, _, _ = page.rows()
    assert at_s[0] == pytest.approx(10.0, abs=0.05)
    assert np.diff(at_s).max() < 0.04
    jump, last_s = page.has[ROBOT][0]["jump"], at_s[-1]
    for _ in range(20):
        page.step(1 / 15)
        at_s, _, _ = page.rows()
        assert page.has[ROBOT][0]["jump"] == jump
        assert 0 < at_s[0] - last_s < 0.04
        last_s = at_s[-1]
    page.do(time_s=35.0)
    assert page.has[ROBOT][0]["jump"] != jump


def test_of_each_feed_one_frame_is_under_way(walked: Path) -> None:
    player = Player(reader.open_episode(walked), 0.0)
    player.obey(Order(time_s=5.0, is_playing=True))
    first = [frame.facts["f"] for frame in player.step(0.0)]
    assert sorted(first) == sorted([PLAY, EPISODE, SCENE, ROBOT, f"{CAMERA}head"])
    assert player.step(0.2) == []
    player.obey(Order(got=ROBOT))
    (robot,) = player.step(0.4)
    assert robot.facts["f"] == ROBOT
    assert robot.facts["rows"] >= 12  # nothing of what was missed


def test_a_robot_that_nothing_of_ours_knows_is_played_by_its_own_description(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.contracts = {item.key: item for item in strider.DESCRIPTION.contracts()}
    for number in range(50):
        q = np.array([0.01, -0.02]) * number
        builder.write(strider.step(number, q + 0.5) | {keys.robot_state(strider.NAME): strider.state(q)},
                      at_s=number / 50, writer="walker")  # fmt: skip
    page = Watched(builder.finish({"servers": {"walker": strider.facts()}}))
    page.do(time_s=0.5)
    scene, (_, measured, asked) = page.json(SCENE), page.rows()
    assert scene["joints"] == list(strider.KNEES)
    assert "not drawn" in scene["note"]
    np.testing.assert_allclose(measured[-1], [0.24, -0.48], rtol=1e-6)
    np.testing.assert_allclose(asked[-1], [0.74, 0.02], rtol=1e-5)


def test_of_several_robots_one_is_shown_and_another_when_it_is_asked_for(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.contracts = {item.key: item for item in strider.DESCRIPTION.contracts()}
    for number in range(50):
        tick(builder, number, at_s=0.1 + number / 50)
        q = np.array([0.01, -0.02]) * number
        builder.write(strider.step(number, q) | {keys.robot_state(strider.NAME): strider.state(q)},
                      at_s=0.105 + number / 50, writer="walker")  # fmt: skip
    page = Watched(builder.finish({"servers": {"walker": strider.facts()}, "robot": {"suffix": G1}}))
    assert sorted(page.json(EPISODE)["robots"]) == sorted([G1, strider.NAME])
    page.do(time_s=0.5)
    assert (page.told()["robot"], page.has[ROBOT][0]["robot"]) == (G1, G1)
    page.do(robot=strider.NAME)
    assert (page.told()["robot"], page.told()["time_s"]) == (strider.NAME, 0.5)
    assert page.json(SCENE)["joints"] == list(strider.KNEES)
    np.testing.assert_allclose(page.rows()[1][-1], [0.19, -0.38], rtol=1e-6)
    page.do(robot="nobody")
    assert page.told()["robot"] == strider.NAME


def test_damage_is_told_and_the_rest_is_played(walked: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    folder.mkdir()
    data = bytearray((walked / layout.SIGNALS).read_bytes())
    chunks = reader.open_episode(walked).parts[0].contents.chunks
    place = chunks[len(chunks) // 2]
    data[place.offset + place.length - 5] ^= 0xFF
    (folder / layout.SIGNALS).write_bytes(data)
    (folder / layout.MANIFEST).write_bytes((walked / layout.MANIFEST).read_bytes())
    page = Watched(folder)
    page.do(time_s=39.0, is_playing=True)
    assert "damaged" in page.told()["note"]
    assert not page.told()["is_playing"]
    page.do(time_s=5.0)
    assert page.told()["note"] == ""
    joints = [f"{name}_pos" for name in page.json(SCENE)["joints"]]
    np.testing.assert_array_equal(page.rows()[1][-1], _at(walked, keys.sim_qpos(G1), 5.0, *joints).astype("f4"))


def _stranger(builder: EpisodeBuilder) -> None:
    """Values that are none, of keys that have contracts."""
    for number in range(100):
        bad = (b"", b"\xff" * 7, codec.f64(np.full(36, np.nan)), codec.f64(np.full(36, 1e300)))[number % 4]
        builder.write({keys.sim_qpos(G1): bad, keys.robot_state(G1): bad, keys.command_gate(G1): b"[" * 10_000,
                       keys.camera_image("head"): bad}, at_s=number / 50)  # fmt: skip


def test_values_that_are_none_show_nothing(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    _stranger(builder)
    servers = {"g1": {"robot": G1, "robot_facts": {"model": "/etc/passwd", "model_sha256": 7}}, "x": {"robot": [1]}}
    page = Watched(builder.finish({"servers": servers, "timing": {"duration_s": math.nan}}))
    for time_s in np.linspace(0.0, 2.0, 21):
        page.do(time_s=float(time_s))
    assert page.told()["note"] == ""
    assert page.json(EPISODE)["length_s"] == pytest.approx(1.98, abs=0.01)
    for facts, payload in page.has.values():
        json.dumps(facts, allow_nan=False)
        assert len(payload) < 10_000_000


def _shortly(builder: EpisodeBuilder) -> None:
    _walk(builder, 2.0)


def _of_no_time(builder: EpisodeBuilder) -> None:
    builder.foreign("x", b"1", at_s=0.0)
    builder.foreign("x", b"1", at_s=1e8)


@pytest.mark.parametrize(
    ("build", "torn", "words"),
    [(_shortly, True, "never finished.*station episodes repair"), (_of_no_time, False, "times cannot be"),
     (lambda _: None, False, "no messages")],
    ids=["unfinished", "absurd times", "empty"],
)  # fmt: skip
def test_what_cannot_be_played_says_why_in_a_line(tmp_path: Path, build: Build, torn: bool, words: str) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    build(builder)
    with pytest.raises(EpisodeError, match=words) as refused:
        Player(reader.open_episode(builder.finish(torn=torn)), 0.0)
    assert "\n" not in str(refused.value)


# -- As a process of a console -----------------------------------------------------------------------------------------


class Viewer:
    """The socket of a page's frames, that shows an episode."""

    def __init__(self, console: ConsoleProcess, episode: str) -> None:
        self.socket: PageSocket = console.view()
        self.episode, self.opened = episode, 1
        self.socket.say(want=[PLAY, EPISODE, SCENE, ROBOT, f"{CAMERA}head"])
        self.order()

    def order(self, **order: Any) -> None:
        self.socket.say(play={"episode": self.episode, "opened": self.opened, "order": order})

    def frames(self) -> Iterable[tuple[dict[str, Any], bytes]]:
        """Take frames, each used at once."""
        while True:
            facts, payload = self.socket.frame(DEADLINE_S)
            self.socket.say(got=facts["f"])
            yield facts, payload

    def until(self, holds: Callable[[dict[str, Any]], Any]) -> tuple[dict[str, Any], bytes]:
        return next((facts, payload) for facts, payload in self.frames() if holds(facts))

    def error(self) -> str:
        return str(self.until(lambda facts: facts["f"] == PLAY and "error" in facts)[0]["error"])


@pytest.fixture
def console(start_console: StartConsole, tmp_path: Path) -> ConsoleProcess:
    """A console with an episode of two seconds."""
    builder = EpisodeBuilder(tmp_path / "data")
    _walk(builder, 2.0)
    builder.finish()
    made = start_console()
    wait_until(lambda: "-walk-0001" in made.ask("/api/episode?id=2026-11-21-g1-walk-0001")[1].decode())
    return made


WALKED = "2026-11-21-g1-walk-0001"


def test_a_viewer_has_an_episode_played_and_its_player_goes_with_it(console: ConsoleProcess, tmp_path: Path) -> None:
    folder = tmp_path / "data/walk" / WALKED
    page = Viewer(console, WALKED)
    page.order(time_s=1.5, number=7)
    facts, _ = page.until(lambda facts: facts["f"] == PLAY and facts.get("number") == 7)
    assert (facts["time_s"], facts["opened"]) == (1.5, 1)
    page.order(is_playing=True)
    page.until(lambda facts: facts["f"] == ROBOT and facts["time_s"] > 1.6)
    assert len(players(folder)) == 1
    page.socket.close()
    wait_until(lambda: not players(folder))


def test_a_player_ends_with_a_console_that_is_killed(console: ConsoleProcess, tmp_path: Path) -> None:
    folder = tmp_path / "data/walk" / WALKED
    page = Viewer(console, WALKED)
    page.until(lambda facts: facts["f"] == SCENE)
    console.kill()
    wait_until(lambda: not players(folder))
    page.socket.close()


def test_a_few_are_played_at_a_time(console: ConsoleProcess, tmp_path: Path) -> None:
    pages = [Viewer(console, WALKED) for _ in range(4)]
    for page in pages:
        page.until(lambda facts: facts["f"] == SCENE)
    fifth = Viewer(console, WALKED)
    assert "4 episodes are being played already" in fifth.error()
    pages[0].socket.say(play=None)
    wait_until(lambda: len(players(tmp_path / "data/walk" / WALKED)) == 3)
    fifth.opened += 1
    fifth.order()
    facts, _ = fifth.until(lambda facts: facts["f"] == SCENE)
    assert facts["opened"] == 2
    for page in (*pages, fifth):
        page.socket.close()


def test_what_cannot_be_played_is_told_to_the_page(console: ConsoleProcess, tmp_path: Path) -> None:
    page = Viewer(console, "../../etc")
    assert "no such episode" in page.error()
    broken = EpisodeBuilder(tmp_path / "data", number=2)
    _walk(broken, 0.5)
    signals = broken.finish() / layout.SIGNALS
    signals.write_bytes(signals.read_bytes()[:300] + b"\x00" * 300)
    torn = EpisodeBuilder(tmp_path / "data", number=3)
    _walk(torn, 0.5)
    torn.finish(torn=True)
    wait_until(lambda: console.ask(f"/api/episode?id={torn.episode_id}")[0] == 200)
    for builder in (broken, torn):
        page.episode, page.opened = builder.episode_id, page.opened + 1
        page.order()
        assert "never finished" in page.error()
    page.socket.close()


def test_a_player_that_dies_is_told_of_and_the_page_lives(console: ConsoleProcess, tmp_path: Path) -> None:
    page = Viewer(console, WALKED)
    page.until(lambda facts: facts["f"] == SCENE)
    (pid,) = players(tmp_path / "data/walk" / WALKED)
    os.kill(pid, signal.SIGKILL)
    assert "ended by itself" in page.error()
    page.opened += 1
    page.order(time_s=1.0)
    page.until(lambda facts: facts["f"] == SCENE and facts["opened"] == 2)
    page.socket.close()


def test_what_no_page_of_ours_says_changes_nothing(console: ConsoleProcess) -> None:
    page = Viewer(console, WALKED)
    page.until(lambda facts: facts["f"] == SCENE)
    for said in ({}, [], 7, "x", {"episode": 1}, {"episode": WALKED, "opened": 1, "order": {"speed": 1e9}},
                 {"episode": WALKED, "opened": 1, "order": {"time_s": "soon"}}, {"order": None}):  # fmt: skip
        page.socket.say(play=said)
    page.order(time_s=1.0, number=3)
    assert page.until(lambda facts: facts.get("number") == 3)[0]["time_s"] == 1.0
    page.socket.close()
