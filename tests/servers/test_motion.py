"""The motion server as a process of its own, on a real bus; the test plays the robot."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.commands import twist, twist2
from adapters.motions.clip import Clip
from adapters.motions.load import load
from adapters.motions.npz_file import save
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from servers.motion import KIND, MotionConfig, Player
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import Tap, open_tap
from station.config import build
from station.errors import ConfigError
from station.life.server import Life, read_health
from station.protocols import Floats, Reference
from tests import six_joints
from tests.adapters.motions.made import smooth
from tests.waiting import DEADLINE_S, wait_until

FORMAT = twist2.FORMAT
SOURCE = keys.command_source(FORMAT.robot)
STATE = keys.robot_state(FORMAT.robot)
MARK = "read_up_to"
RUN = """
import json, sys
from servers.motion import KIND, MotionConfig
from station.bus.address import parse
from station.config import build
from station.life.serving import serve
sys.exit(serve(KIND, build(MotionConfig, json.loads(sys.argv[2]), where="test"), address=parse(sys.argv[1])))
"""
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    """A walk of 0.6 s."""
    walk, path = smooth(frames=19), tmp_path / "walk.npz"
    save(path, fps=walk.fps, root_pos=walk.root_pos, root_quat_wxyz=walk.root_quat_wxyz, joint_pos=walk.q,
         joint_names=G1_29)  # fmt: skip
    return path


@pytest.fixture
def start(bus_server: BusAddress, motion: Path, tmp_path: Path) -> Iterator[Start]:
    """Starts the server on the walk; what still runs at the end is killed."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(**config: Any) -> subprocess.Popen[bytes]:
        options = {"motion": str(motion), "enter_s": 0.2, "leave_s": 0.3, "seek_s": 0.2, "ease_s": 0.2, **config}
        command = [sys.executable, "-c", RUN, bus_server.url, json.dumps(options)]
        with (tmp_path / "stderr").open("wb") as stderr:
            started.append(subprocess.Popen(command, cwd=tmp_path, stderr=stderr))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


class Tick:
    """What the server wrote in one go."""

    def __init__(self, values: dict[str, bytes]) -> None:
        self.values = values
        self.command = codec.parse_json_vector(values[FORMAT.key], 35)
        self.source = json.loads(values[SOURCE])
        self.phase: str = self.source["phase"]


class StandInRobot:
    """Answers each command with a state, as a low-level server in lock-step does."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._watch = bus.watch([FORMAT.key])
        self._newest = self._watch.latest(FORMAT.key)

    def command(self, timeout_s: float = DEADLINE_S) -> Tick:
        self._newest = self._watch.wait(FORMAT.key, after=self._newest, timeout_s=timeout_s)
        assert self._newest is not None, "no command came"
        samples = self._bus.read([FORMAT.key, SOURCE])
        return Tick({key: sample.value for key, sample in samples.items()})

    def tick(self) -> Tick:
        self._bus.publish({STATE: codec.f64(np.zeros(3))})
        return self.command()

    def until(self, phase: str, at_most: int = 400) -> list[Tick]:
        ticks = [self.tick()]
        while ticks[-1].phase != phase:
            ticks.append(self.tick())
            assert len(ticks) < at_most, f"no {phase} in {at_most} ticks"
        return ticks

    def close(self) -> None:
        self._watch.close()


@pytest.fixture
def robot(bus: Bus) -> Iterator[StandInRobot]:
    stand_in = StandInRobot(bus)
    yield stand_in
    stand_in.close()


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[Tap]:
    opened = open_tap(bus_server)
    yield opened
    opened.close()


class Writes:
    """Everything that is written, by key, in order."""

    def __init__(self, tap: Tap, bus: Bus) -> None:
        self._tap, self._bus, self._reads = tap, bus, 0
        self.by_key: dict[str, list[tuple[bytes, bytes]]] = {}

    def read(self) -> Writes:
        """Read up to a write of our own: all that was written before."""
        self._reads += 1
        mark = str(self._reads).encode()
        self._bus.call("SET", MARK, mark)
        while not self.by_key.get(MARK) or self.by_key[MARK][-1][0] != mark:
            for write in self._tap.read(0.01):
                if write.value is not None:
                    self.by_key.setdefault(write.key, []).append((write.value, write.stamp or b""))
        return self

    def events(self, name: str) -> list[dict[str, Any]]:
        found = [json.loads(value) for value, _ in self.read().by_key.get(keys.EVENT, [])]
        return [event["detail"] for event in found if event["name"] == name]


@pytest.fixture
def writes(tap: Tap, bus: Bus) -> Writes:
    return Writes(tap, bus)


def finish(process: subprocess.Popen[bytes]) -> int:
    return process.wait(DEADLINE_S)


def commands(writes: Writes) -> Floats:
    return np.array([codec.parse_json_vector(value, 35) for value, _ in writes.read().by_key[FORMAT.key]])


def test_by_the_clock_a_motion_is_played_from_default_to_default(start: Start, motion: Path, writes: Writes) -> None:
    process = start()
    wait_until(lambda: writes.events("motion-end"))
    assert finish(process) == 0
    vectors = commands(writes)
    np.testing.assert_array_equal(vectors[0], FORMAT.default)
    np.testing.assert_array_equal(vectors[-1], FORMAT.default)
    assert writes.events("motion-end")[0]["is_complete"] is True
    assert len(writes.events("motion-start")) == 1
    clip = load(motion)
    sources = [json.loads(value) for value, _ in writes.by_key[SOURCE]]
    playing = [index for index, source in enumerate(sources) if source["phase"] == "playing"]
    assert len(playing) == 30  # 0.02 s to 0.6 s
    for index in playing:
        expected = FORMAT.encode(clip.at(sources[index]["time_s"]), clip.joint_names)
        np.testing.assert_array_equal(vectors[index], expected)
    assert sources[playing[-1]]["time_s"] == clip.duration_s
    assert sources[playing[-1]]["frame"] == 18
    assert sources[0]["sha256"] == clip.facts()["sha256"]


def test_each_tick_is_one_write_of_all_that_stock_readers_need(start: Start, writes: Writes) -> None:
    assert finish(start()) == 0
    writes.read()
    together = [FORMAT.key, *FORMAT.auxiliary, twist_keys.T_ACTION, SOURCE]
    marks = [[stamp.decode(mark) for _, mark in writes.by_key[key]] for key in together]
    for of_one_tick in zip(*marks, strict=True):
        instants = {(mark.seq, mark.mono_ns, mark.source) for mark in of_one_tick if mark is not None}
        assert len(instants) == 1
    assert json.loads(writes.by_key[twist_keys.action_neck()][0][0]) == [0.0, 0.0]
    assert json.loads(writes.by_key[twist_keys.action_hand("left")][0][0]) == [0.0] * 7
    written = stamp.decode(writes.by_key[twist_keys.T_ACTION][0][1])
    assert written is not None
    assert abs(int(writes.by_key[twist_keys.T_ACTION][0][0]) - written.wall_ns / 1e6) < 1000


def test_twist_gets_its_own_vector_and_hands(start: Start, writes: Writes) -> None:
    assert finish(start(format="twist")) == 0
    vectors = [json.loads(value) for value, _ in writes.read().by_key["action_mimic_g1"]]
    assert vectors[0] == vectors[-1] == twist.FORMAT.default.tolist()
    assert json.loads(writes.by_key["action_hand_g1"][0][0]) == [0.0] * 14


def test_what_it_runs_stands_on_the_bus_before_it_starts(start: Start, bus: Bus, motion: Path) -> None:
    process = start(wait_for_start=True)
    wait_until(lambda: any(health.state == "active" for health in read_health(bus)))
    facts = json.loads(bus.get(keys.server_config("motion")) or b"{}")
    assert facts["motion"]["file"] == str(motion)
    assert facts["command"]["format"] == "twist2"
    assert facts["config"]["pace"] == "wall"
    process.send_signal(signal.SIGTERM)
    assert finish(process) == 0


def test_in_lock_step_each_state_gets_one_frame_and_two_runs_are_equal(start: Start, robot: StandInRobot) -> None:
    runs = []
    for _ in range(2):
        process = start(pace="state", patience_s=DEADLINE_S)  # nothing is sent twice, however late we answer
        ticks = [robot.command(), *robot.until("done")]
        assert finish(process) == 0
        runs.append(ticks)
    first, second = runs
    assert [tick.phase for tick in first].count("playing") == 30
    assert len(first) == 1 + 10 + 29 + 15
    for one, other in zip(first, second, strict=True):
        assert one.values[FORMAT.key] == other.values[FORMAT.key]
    answered = [tick.source["state_seq"] for tick in second[1:]]
    assert answered == list(range(answered[0], answered[0] + len(answered)))


def test_in_lock_step_a_robot_that_was_held_up_as_the_motion_leaves_is_waited_for(
    start: Start, robot: StandInRobot
) -> None:
    process = start(pace="state", patience_s=DEADLINE_S)
    before = [robot.command(), *robot.until("leaving")]
    time.sleep(0.5)  # a busy machine
    left = robot.until("done")
    assert finish(process) == 0
    assert len(before) + len(left) == 1 + 10 + 29 + 15


def test_a_silent_robot_is_an_event_and_leaving_does_not_wait_for_it(
    start: Start, robot: StandInRobot, writes: Writes
) -> None:
    process = start(pace="state", patience_s=0.2)
    robot.command()
    robot.until("playing")
    wait_until(lambda: writes.events("robot-silent"))
    robot.command()  # the same one, again
    robot.tick()
    wait_until(lambda: writes.events("robot-back"))
    process.send_signal(signal.SIGTERM)
    assert finish(process) == 0
    np.testing.assert_array_equal(commands(writes)[-1], FORMAT.default)


def test_ctrl_c_in_the_middle_blends_back_to_the_default(start: Start, writes: Writes) -> None:
    process = start(loop=True)
    wait_until(lambda: writes.events("motion-start"))
    process.send_signal(signal.SIGINT)
    assert finish(process) == 0
    vectors = commands(writes)
    np.testing.assert_array_equal(vectors[-1], FORMAT.default)
    leaving = [json.loads(value)["phase"] for value, _ in writes.by_key[SOURCE]].count("leaving")
    assert leaving == 14  # of 15 steps: the last one is done
    assert writes.events("motion-end")[0]["is_complete"] in (True, False)


def control(bus: Bus, writes: Writes, request: Any) -> None:
    seen = len(writes.events("motion-control"))
    bus.publish({keys.MOTION_CONTROL: json.dumps(request).encode()})
    wait_until(lambda: len(writes.events("motion-control")) > seen)


def test_an_operator_pauses_seeks_resumes_and_ends(start: Start, robot: StandInRobot, bus: Bus, writes: Writes) -> None:
    process = start(pace="state", patience_s=0.1)  # sends again when nothing comes, so requests are seen
    robot.command()
    robot.until("playing")
    control(bus, writes, {"action": "pause", "id": "once"})
    wait_until(lambda: robot.tick().phase == "paused")
    for _ in range(20):
        paused = robot.tick()
    assert not paused.command[[0, 1, 5]].any()
    control(bus, writes, {"action": "seek", "time_s": 0.4})
    wait_until(lambda: robot.tick().source["time_s"] == pytest.approx(0.4))
    bus.publish({keys.MOTION_CONTROL: b'{"action": "resume", "late_s": 60}'})  # first written before the others
    wait_until(lambda: writes.events("motion-control-refused"))
    assert "was asked for after it was done before it" in writes.events("motion-control-refused")[0]["reason"]
    assert robot.tick().phase == "paused"
    control(bus, writes, {"action": "resume"})
    robot.until("playing")
    control(bus, writes, {"action": "pause", "id": "once"})  # written again: answered again, and not done again
    assert {robot.tick().phase for _ in range(5)} == {"playing"}
    control(bus, writes, {"action": "leave", "late_s": 60})  # what ends a movement is done however late it comes
    robot.until("done")
    assert finish(process) == 0
    told = [event["action"] for event in writes.events("motion-control")]
    assert told == ["pause", "seek", "resume", "pause", "leave"]


def test_a_request_that_makes_no_sense_is_an_event(start: Start, bus: Bus, writes: Writes) -> None:
    process = start(wait_for_start=True)
    wait_until(lambda: FORMAT.key in writes.read().by_key)
    for request in (
        b"nonsense",
        b'{"action": "jump"}',
        b'{"action": "seek"}',
        b'{"action": "resume"}',
        b"[1]",
        b"\xff",
    ):
        seen = len(writes.events("motion-control-refused"))
        bus.publish({keys.MOTION_CONTROL: request})
        wait_until(lambda seen=seen: len(writes.events("motion-control-refused")) > seen)  # type: ignore[misc]
    assert "resume does not apply while waiting" in str(writes.events("motion-control-refused"))
    process.send_signal(signal.SIGTERM)
    assert finish(process) == 0


def test_the_stock_remote_starts_and_ends_and_an_old_signal_does_not(start: Start, bus: Bus, writes: Writes) -> None:
    bus.call("SET", twist_keys.MOTION_START_SIGNAL, "1")
    process = start(wait_for_start=True, loop=True)
    wait_until(lambda: len(writes.read().by_key.get(FORMAT.key, [])) > 10)
    assert bus.get(twist_keys.MOTION_START_SIGNAL) == b"0"
    assert not writes.events("motion-start")
    np.testing.assert_array_equal(commands(writes)[-1], FORMAT.default)
    bus.call("SET", twist_keys.MOTION_START_SIGNAL, "1")
    wait_until(lambda: writes.events("motion-start"))
    bus.call("SET", twist_keys.MOTION_EXIT_SIGNAL, "1")
    assert finish(process) == 0
    np.testing.assert_array_equal(commands(writes)[-1], FORMAT.default)


def test_a_second_writer_is_an_event_when_it_comes_and_when_it_is_gone(start: Start, bus: Bus, writes: Writes) -> None:
    process = start(wait_for_start=True)
    wait_until(lambda: FORMAT.key in writes.read().by_key)

    def rival_is_seen() -> bool:
        bus.call("SET", FORMAT.key, b"[0.0]")
        return bool(writes.events("second-writer"))

    wait_until(rival_is_seen)
    wait_until(lambda: len(writes.events("second-writer")) > 1)
    came, gone = writes.events("second-writer")[:2]
    assert (came["key"], came["writers"]) == (FORMAT.key, ["foreign"])
    assert gone["ended"] is True
    process.send_signal(signal.SIGTERM)
    assert finish(process) == 0


def test_a_motion_that_cannot_be_read_ends_the_server_before_it_commands_anything(
    start: Start, bus: Bus, tmp_path: Path
) -> None:
    assert finish(start(motion=str(tmp_path / "absent.pkl"))) != 0
    assert b"absent.pkl: no such file" in (tmp_path / "stderr").read_bytes()
    assert bus.get(FORMAT.key) is None


def test_without_a_display_a_preview_is_a_rerun_file(
    start: Start, writes: Writes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert finish(start(preview=True, preview_file="seen/walk.rrd")) == 0
    assert writes.events("preview") == [{"where": "seen/walk.rrd"}]
    assert not writes.events("preview-ended")
    assert (tmp_path / "seen/walk.rrd").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("key", "value"),
    [("rate_hz", 0.0), ("enter_s", 0.0), ("leave_s", -1.0), ("lead_s", 9.0), ("patience_s", 0.0), ("pace", "fast"),
     ("loops", True)],
)  # fmt: skip
def test_a_bad_configuration_names_the_key(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=key):
        build(MotionConfig, {"motion": "walk.npz", key: value}, where="test")


class BrokenWalk(Clip):
    """A motion that fails in its middle."""

    def at(self, time_s: float) -> Reference:
        if time_s > 0.3:
            raise RuntimeError("the clip is torn")
        return super().at(time_s)


def test_an_error_in_the_middle_still_ends_in_the_default(bus: Bus, writes: Writes) -> None:
    config = MotionConfig(motion="torn.npz", enter_s=0.1, leave_s=0.2)
    life = Life(KIND, "motion", bus, "")
    try:
        with bus.watch([FORMAT.key]) as watch, pytest.raises(RuntimeError, match="torn"):
            Player(config, life, BrokenWalk(smooth(frames=19)), FORMAT, watch).run()
    finally:
        life.end("test")
    assert writes.events("motion-error")[0]["reason"] == "RuntimeError: the clip is torn"
    vectors = commands(writes)
    np.testing.assert_array_equal(vectors[-1], FORMAT.default)
    leaving = vectors[-11:]  # 0.2 s: ten equal steps from the last good vector
    np.testing.assert_allclose(
        np.diff(leaving, axis=0), np.tile((FORMAT.default - leaving[0]) / 10, (10, 1)), atol=1e-9
    )


def test_what_rests_where_it_is_has_no_pose_to_begin_a_motion_from(monkeypatch: pytest.MonkeyPatch) -> None:
    six_joints.register(monkeypatch)
    with pytest.raises(
        ConfigError, match="format 'six': six rests where it is, and has no pose to begin a motion from"
    ):
        KIND.main(MotionConfig(motion="builtin:wave", format="six"), None)
