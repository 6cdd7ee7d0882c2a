"""Every parser of values of the bus that runs while a station does, as a function of the bytes of one value.

`modules` of a parser are those whose reading of the bus it runs; tests/fuzz/test_fuzz.py sees that none is missing.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import json
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import rerun as rr
from rich.console import Console, RenderableType

from adapters import pose_server
from adapters.cameras.mujoco_robot import MujocoCamera
from adapters.commands import twist, twist2
from adapters.commands.arm import arm_command
from adapters.devices.fakes.natnet import packets, person
from adapters.devices.natnet import wire
from adapters.devices.natnet.actor import Actor, NotAPerson
from adapters.devices.webxr import frame as webxr_frame
from adapters.exports.ros2 import messages as ros_messages_of_bags
from adapters.exports.ros2 import ros_types
from adapters.lcm import homie
from adapters.lcm import packet as lcm_packet
from adapters.lcm import types as lcm_types
from adapters.lcm.message import BadMessage
from adapters.lidars import livox_packets, ros_messages
from adapters.lidars.room import Room
from adapters.motions.clip import Clip
from adapters.retarget.human import of_height, standing
from adapters.robots import arm_limits
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.dds import words
from adapters.ros2 import table as ros2_table
from adapters.ros2 import told as ros2_told
from adapters.sonic import message as sonic_message
from adapters.sonic import planner as sonic_planner
from adapters.sonic import pose as sonic_pose
from servers import lcm as lcm_server
from servers.ros2 import Frame, Intake
from station import depth, point_cloud
from station.api.live import Record, Station
from station.bus import clocks, codec, contracts, keys, stamp
from station.bus.address import BusAddress
from station.bus.sample import Sample
from station.bus.tap import Write, not_mirrored
from station.camera.source import Drops
from station.cli import logs, pair
from station.clock import SYSTEM
from station.contract import TIMING_STAGES
from station.control.command_validator import CommandSample, CommandValidator, check_command
from station.control.envelope import Envelope, Ranges, Span, stated
from station.control.foreign_stream import why_not_as_described
from station.control.stop_trace import StopTrace
from station.enrich.live import LiveKey, written_wall_ns
from station.enrich.scalars import Shape
from station.enrich.siblings import siblings
from station.episode.reading import vectors
from station.episode.reading.messages import Channel, Message
from station.episode.reading.steps import robot_state, timing_row
from station.episode.recorder import controller
from station.episode.replaying.gate_audit import stated_envelopes
from station.episode.storage import pictures
from station.episode.storage.channels import encoding_of, source_of
from station.episode.storage.manifest import Manifest, Timing, dump_manifest
from station.episode.storage.request import parse_answer, parse_request, request_id
from station.episode.writing import servers_seen, summary
from station.errors import ConfigError, NotReady, Refused, UnknownName, UsageError
from station.life import (
    arm_request,
    controller_request,
    estop,
    events,
    policy_request,
    runbook_request,
    stop_button,
    stop_file,
    stop_line,
    twin_request,
)
from station.life.request import parse
from station.life.server import Health, decode_health
from station.life.stop_file import StopFile
from station.motion.playback import Playback
from station.motion.playback_requests import Requests
from station.operator import sample as readings
from station.operator.device_subscriber import DeviceSubscriber
from station.operator.phrases import Phrases
from station.operator.requests import RecordButtons
from station.operator.robot_side import RobotSide
from station.operator.sample import Body, OperatorSample, Pose, Status
from station.operator.script_time import now_s
from station.operator.station_monitor import SilenceMonitor, StationMonitor
from station.protobuf import foxglove
from station.supervision import agent, doctor, hosts, measuring
from station.supervision.doctor import Finding
from station.view import episode_story, find_model, phases, progress_panel, status
from station.view.clouds import log_cloud
from station.view.progress import ProgressReader
from station.web import asks, look, sockets
from station.web.drawn_robot import DrawnRobot
from tests.adapters.motions.made import smooth
from tests.episode.filming import cloud
from tests.fuzz.shelf import Shelf

ROBOT, ARM = twist_keys.TWIST2_ROBOT, "kassow_kr810"
Parse = Callable[[bytes], object]


class Parser(NamedTuple):
    """A parser.

    Attributes:
        name: What it reads, for a report.
        parse: Does with a value all that the process does that reads it.
        valid: Good values.
        modules: Whose reading it runs.
        promise: What it may raise.
    """

    name: str
    parse: Parse
    valid: tuple[bytes, ...]
    modules: tuple[str, ...]
    promise: tuple[type[Exception], ...] = ()


def _shown(*pages: RenderableType) -> None:
    Console(file=io.StringIO(), width=120).print(*pages)


# ---- values ----

NOW_NS = time.time_ns()
EVENT = events.make("g1", "fall", "warning", tilt_rad=1.2, contacts=["hand"], reason="so; it is", episode_id="a-0007")
_CLIPS = [{"name": "wave", "start_s": 0.0, "end_s": 6.0}, {"name": "bow", "start_s": 6.0}]
RUNBOOK: dict[str, Any] = {
    "name": "t", "robot": ROBOT, "robot_is_real": True, "steps": [{"text": "start g1", "state": "now", "result": "a"}],
    "question": {"id": "1", "sentence": "Clear?", "answers": ["yes", "no"], "hold_s": 1.2},
    "results": [{"id": "2", "refused": "too late"}], "is_over": False,
}  # fmt: skip
DESCRIPTION: dict[str, Any] = {
    "name": ROBOT, "model": "strider", "joints": [{"name": "knee", "lower": -1.0, "upper": 1.5}, {"name": "hip"}],
    "groups": {"leg": ["knee", "hip"]}, "parts": {"hand": ["action_hand_{robot}", "state_hand_{robot}"]},
    "streams": [{"key": "robot_state_{robot}", "family": "station", "role": "state", "codec": "f64", "rate_hz": 50.0,
                 "elements": [{"name": "{joint}_pos", "unit": "rad"}, {"name": "tick", "unit": ""}]}],
}  # fmt: skip
CONFIG: dict[str, Any] = {
    "kind": "g1", "role": "low-level", "robot": ROBOT, "rate_hz": 50.0, "fake_began_wall_ns": NOW_NS,
    "policy": {"name": "tracker", "checkpoint": "a.onnx", "sha256": "ab", "command": "twist2", "rate_hz": 50},
    "policies": {"tracker": {"name": "tracker"}, "b": {"name": "tracker", "checkpoint": "b.onnx"}},
    "robot_facts": {"model": "builtin:g1.xml", "model_sha256": "ab"},
    "motion": {"file": "builtin:tour", "duration_s": 20.0, "clips": _CLIPS},
    "config": {"fake": "here/script.json"}, "device": {"library": "none"}, "fps": 30, "key": "camera_image_a",
    "description": DESCRIPTION,
}  # fmt: skip
SOURCE = {"kind": "motion", "file": "a.pkl", "sha256": "ab", "phase": "playing", "time_s": 1.5, "engaged": True}
ENVELOPE = Envelope(
    bounded=Ranges(elements=("vx", "vy"), lower=(-1.0, -0.5), upper=(1.0, 0.5), rate=(6.0, 6.0)),
    sums=((1.0, 0.5),),
    spans=(Span(over_s=0.5, lower=(-1.0,), upper=(1.0,)),),
)
GATE: dict[str, Any] = {
    "state": "tracking", "reason": "", "arming": "armed", "age_s": 0.01, "clamped": 0, "refused": 3,
    "arm": {"id": "1", "action": "arm", "refused": ""}, "controller": {"id": "1", "action": "clear", "refused": ""},
    "policy": "tracker", "next_policy": "b", "switch": {"id": "1", "policy": "b", "refused": ""},
}  # fmt: skip
RECORDER = {"state": "recording", "episode_id": "e-1", "path": "/d/t/e-1", "messages": 3, "bytes": 9, "free_mb": 2.5}
REQUEST: dict[str, Any] = {
    "id": "7", "action": "start", "task": "walk", "instruction": "go", "operator": {"id": "ada", "interface": "pico"},
    "runbook": {"steps": [1, "x"]}, "planned_s": 60.0, "label": "m", "success": True,
}  # fmt: skip
ANSWER = {"id": "7", "ok": True, "episode_id": "e-1", "path": "/d", "reason": "", "summary": {"seconds": 3.5}}
KEPT_STOP = {"bus": "b", "stop": True, "reason": "so", "since_wall_ns": 1, "asked_ns": 1, "boot": "x"}
STAMP = stamp.Stamp(7, time.monotonic_ns(), NOW_NS, stamp.new_source("g1"), 5).encode()
FAR = "0badcafe"
CLOCK = codec.json_object(clocks.ClockStatement(
    boot=FAR, host="operator-pc", mono_ns=7, wall_ns=NOW_NS, bus_ns=2 * NOW_NS, error_ns=9, since_bus_ns=0,
    round_trip_ns=9, comparisons=32, is_synchronised=True, wall_error_ns=5,
))  # fmt: skip
TIMING = codec.json_vector([3, 7, *range(10**12, 10**12 + len(TIMING_STAGES))])


def dumped(value: Any) -> bytes:
    """JSON text."""
    return json.dumps(value).encode()


def health(name: str = "g1", role: str = "low-level") -> bytes:
    """A heartbeat of now, of a server that runs in this process."""
    said = Health(
        name=name, role=role, state="active", pid=os.getpid(), host=socket.gethostname(),  # type: ignore[arg-type]
        boot=stamp.boot_id(),
        source="g1.1.ab.cd", started_wall_ns=NOW_NS, wall_ns=time.time_ns(), rate_hz=50.0, jitter_p50_ms=0.1,
        jitter_p99_ms=0.3, overruns=1, events=[EVENT], reason="",
        detail={"falls": 1, "refused": {"not-json": 2}, "gate": "tracking", "profile": "a", "engaged": True,
                "mode": "m", "sync_hz": 250.0, "why_not": ""},
    )  # fmt: skip
    return codec.json_object(said)


# ---- commands and requests ----

_WANTED_G1 = {"kind": "g1", "config": {"policy": "tracker"}, "agent": 5, "process": 1, "restarts": 0, "stage": "run"}
WANTED = {"station": "a", "who": "ada", "servers": {"g1": _WANTED_G1}}


_SWITCHER_ANSWER = bytes(4) + b"\x05" + bytes(7) + b"\xe9\3" + bytes(6) + bytes(4) + b"\x0f\0\0\0" + b'{"name": "ai"}\0'


def _motion_switcher(data: bytes) -> None:
    if (answer := words.answer_of(b"\0\1" + data[2:])) is not None:
        words.name_of(answer.text)


def _host_facts(data: bytes) -> object:
    said = decode_health(data)
    return None if said is None else hosts.facts_of(said)


def _command(command_format: Any, data: bytes) -> None:
    validator = CommandValidator(command_format)
    validator.update(CommandSample(data, 1.0))
    validator.is_refusing(1.0, 1.0)
    if validator.vector is not None:
        assert np.isfinite(validator.vector).all()
        assert ((validator.vector >= command_format.lower) & (validator.vector <= command_format.upper)).all()
    check_command(data, command_format)


@cache
def _playback() -> Playback:
    return Playback(Clip(smooth()), twist2.FORMAT)


def _motion_control(data: bytes) -> None:
    shelf = Shelf({})
    signals = twist2.FORMAT.stock.signals
    requests = Requests(shelf, shelf, _playback(), signals)  # type: ignore[arg-type]
    shelf.values = dict.fromkeys((keys.MOTION_CONTROL, *signals), data)
    requests.obey()
    assert np.isfinite(_playback().step(0.02).command).all()


def _stop(data: bytes) -> None:
    trace = StopTrace()
    for key in estop.KEYS:
        request = estop.read(data, key=key)
        codec.json_object({"reason": request.reason, "stop": request.stop})
        trace.on_event(key, b"set")
        trace.on_read(key, data, is_new=True)
    assert trace.is_stop_pending


def _kept_stop(data: bytes) -> None:
    file = StopFile(BusAddress(socket="shelf"))
    file.path = _folder() / "stop.json"
    file.path.write_bytes(data)
    str(file.read())


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _robot_of(key: str, data: bytes) -> None:
    shelf: Any = Shelf({keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG), key: data})
    arm_request.server_of(shelf, ROBOT)


def _policies_of(key: str, data: bytes) -> None:
    shelf: Any = Shelf({keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG), key: data})
    for each in policy_request.policies(shelf):
        ", ".join((each.robot, each.driving, *each.names))


# ---- what servers say ----


def _event(data: bytes) -> None:
    event = events.decode(data)
    if event is None:
        return
    late = events.late(event, NOW_NS)
    codec.json_object([event, late])
    Phrases().cue(event)
    SilenceMonitor().on_event(event)
    foxglove.log(event, NOW_NS)
    str(event)


def _heartbeat(data: bytes) -> None:
    said = decode_health(data)
    if said is None:
        return
    found = status.Status("bus", [said], [])
    json.dumps(found.to_plain())
    _shown(status.render(found))
    list(doctor._servers([said], Path("logs")))
    list(doctor._troubles(said, "key"))
    silence_monitor = SilenceMonitor()
    for now in (1.0, 2.0):
        for event in silence_monitor.step([said], now):
            codec.json_object(event)
    codec.json_object(said)


def _clock(data: bytes) -> None:
    statement = clocks.decode_statement(data, FAR)
    if statement is None:
        return
    found = clocks.offset_of(statement, clocks.Offset(NOW_NS, 1_000), 0, NOW_NS)
    assert found is None or 0 <= found.error_ns <= clocks.MOST_ERROR_NS
    shelf: Any = Shelf({keys.clock(FAR): data})
    said = [decode_health(health(name)) for name in ("g1", "motion")]
    assert said[0] is not None
    assert said[1] is not None
    said[1].boot = FAR
    said[1].wall_ns -= clocks.walls_ahead_ns(shelf.call, [FAR], SYSTEM)[FAR]
    _shown(*(doctor_text(item) for item in doctor._clocks(shelf, [each for each in said if each is not None])))


def _stamped(data: bytes) -> None:
    mark = stamp.decode(data)
    if mark is None:
        return
    assert stamp.decode(mark.encode()) == mark
    age_s = (time.time_ns() - mark.wall_ns) * 1e-9
    item = status.KeyStatus(key="k", role="state", writer=mark.writer, rate_hz=1.0, age_s=age_s)
    _shown(status.render(status.Status("bus", [], [item])))
    json.dumps({"writer": mark.writer, "pid": mark.pid, "boot": mark.is_from_this_boot, "source": source_of(data)})
    np.array([mark.seq, mark.mono_ns, mark.wall_ns, mark.capture_ns or 0], dtype=np.int64)
    pictures.around("camera_image_a", 9, NOW_NS, data)
    assert controller._written_ns(Write(keys.RECORD, b"{}", data, NOW_NS)) <= NOW_NS


def _progress(key: str, data: bytes) -> None:
    """What `station up` shows, with one of the values that it reads replaced."""
    qpos = np.concatenate([[0, 0, 0.8, 1, 0, 0, 0], np.zeros(29)])
    shelf: Any = Shelf({
        keys.server("g1"): health(), keys.server("motion"): health("motion", "command"),
        keys.server_config("g1"): dumped(CONFIG), keys.server_config("motion"): dumped(CONFIG),
        keys.command_source(ROBOT): dumped(SOURCE), keys.command_gate(ROBOT): dumped(GATE),
        keys.policy_timing(ROBOT): TIMING, keys.sim_qpos(ROBOT): codec.f64(qpos), keys.RECORDER: dumped(RECORDER),
    } | {key: data})  # fmt: skip
    seen = ProgressReader(shelf, ("g1", "motion")).poll()
    _shown(progress_panel.panel(seen, ("g1", "motion", "recorder")))
    progress_panel.line(seen)


def _arm_progress(data: bytes) -> None:
    said = json.loads(health())
    said["detail"] |= {"backend": "sim", "send_hz": 125.0}
    if data.startswith(b"{") and data.endswith(b"}"):  # the mutant stands where a server puts its own facts
        _progress(keys.server("g1"), dumped(said).replace(b'"detail": {', b'"detail": {"mutant": ' + data + b", ", 1))
    _progress(keys.server("g1"), data)


def _doctor(key: str, data: bytes) -> None:
    shelf: Any = Shelf({
        keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG), keys.RECORDER: dumped(RECORDER),
        keys.command_gate(ROBOT): dumped(GATE), keys.ESTOP: b"0",
    } | {key: data})  # fmt: skip
    said = decode_health(health())
    assert said is not None
    findings = [
        doctor._estop(stop_file.latched(shelf)), *doctor._gate(shelf, keys.command_gate(ROBOT)),
        *doctor._recorder(shelf, [said]),
    ]  # fmt: skip
    try:
        codec.parse_struct(shelf.get(keys.server_config("g1")), doctor._Stated).obeys()
    except (codec.BadValue, UnknownName) as error:
        findings.append(Finding("broken", "server", str(error)))
    _shown(*(doctor_text(item) for item in findings))


def doctor_text(item: Finding) -> str:
    """A finding as the command prints it."""
    from station.cli.tables import plain

    return f"[bold]{plain(item.subject)}[/]: {plain(item.found)} {plain(item.remedy)}"


def _described(data: bytes) -> None:
    """What follows from what a robot says of itself."""
    known = contracts.Contracts([codec.parse_facts(data)])
    for robot in known.robots():
        description = known.robot(robot)
        for role in ("state", "command"):
            contracts.of_joints(robot, role, known.of(robot), description)
        assert description is not None
        description.part_keys()
    known.all()


def _drawn(data: bytes) -> None:
    """What a viewer makes of configurations, gate, source and event."""
    facts = codec.parse_facts(data)
    find_model.find_path([facts], ROBOT)
    episode_story.line(facts)
    episode_story.level(facts)
    episode_story.gate_state(facts)
    phases.driven_by(facts)
    motion = facts.get("motion")
    phases.PhaseNames(motion if isinstance(motion, dict) else facts)(facts)
    phases.parsed(data)


def _look_on(data: bytes) -> None:
    shelf: Any = Shelf({})
    monitor = StationMonitor.__new__(StationMonitor)
    monitor._watch, monitor._seen = shelf, dict.fromkeys(estop.KEYS)
    shelf.values |= dict.fromkeys(estop.KEYS, data)
    monitor._stop()


DRAWN = DrawnRobot(ROBOT, contracts.Contracts([CONFIG]), [])


def _console(key: str, data: bytes) -> None:
    """What a console makes of a value of a key, and of the same bytes as what a server states and says of itself."""
    shelf: Any = Shelf({key: data})
    shelf.last_error = data.decode(errors="replace")
    looking = look.Look.__new__(look.Look)
    looking.bus, looking.clock, looking._watch, looking._answered_s = shelf, SYSTEM, shelf, 0.0
    looking._contracts = contracts.Contracts()
    looking._robots = {ROBOT: ("g1", data, DRAWN)}
    looking._health = [found] if (found := decode_health(data)) is not None else []
    looking._counts, looking._names, looking._alarms, looking._ahead_ns = {}, [key], {}, {}
    msgspec.json.encode(looking.state())
    looking.urgent()
    looking.keys_table()
    frame = DRAWN.frame(shelf.latest, 1.0)
    if frame is not None:
        frame.packed(2.0)


def _page_frame(data: bytes) -> None:
    found = webxr_frame.sample_of(webxr_frame.parse(data), 0, {})
    assert all(abs(value) <= 1.0 for value in found.controls.values())


def _said_by_a_page(data: bytes) -> None:
    msgspec.convert(sockets.object_of(data.decode(errors="replace")), asks.Ask)


# ---- the recorder ----


def _manifest() -> Manifest:
    return Manifest(episode_id="e-1", timing=Timing(started="now"))


def _heard(key: str, data: bytes) -> None:
    listens = servers_seen.ServersSeen()
    manifest = _manifest()
    listens.record(keys.server("g1"), health(), STAMP, 1)
    listens.record(keys.server_config("g1"), dumped(CONFIG), STAMP, 1)
    listens.record(key, data, STAMP, 2)
    listens.missing_configuration(3)
    listens.fill(manifest)
    servers_seen.add_motion(manifest, keys.command_source(ROBOT), data)
    dump_manifest(manifest)


def _noted(data: bytes) -> None:
    manifest = _manifest()
    summary.add_event(manifest, data, 1.0)
    dump_manifest(manifest)


def _record_request(data: bytes) -> None:
    asker = request_id(data)
    codec.json_object({"id": asker})
    request = parse_request(data)
    manifest = _manifest()
    manifest.operator, manifest.runbook = request.who(), request.runbook
    summary.add_mark(manifest, request.label, 1.0, request.success)
    dump_manifest(manifest)


def _record_state(data: bytes) -> None:
    buttons = RecordButtons.__new__(RecordButtons)
    buttons._watch, buttons._own = Shelf({keys.RECORDER: data}), None  # type: ignore[assignment]
    buttons._is_recording()
    buttons._last_task()


# ---- operators ----

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_POSE = Pose(np.array([0.1, 0.2, 1.0]), _IDENTITY)
_HAND = np.concatenate([np.zeros((26, 3)), np.tile(_IDENTITY, (26, 1))], axis=1)
_READING = OperatorSample(
    capture_ns=5, controls={"left_trigger": 0.5, "right_stick_x": -0.2}, head=_POSE, left=_POSE, right=_POSE,
    body=Body(np.zeros((24, 3)), np.tile(_IDENTITY, (24, 1))), hands={"left": _HAND, "right": _HAND},
    twist=np.zeros(6), joints=np.zeros(7),
)  # fmt: skip
_STATUS = Status(state="live", capture_ns=5, new=7, parts=readings.parts(_READING))
_SAMPLE = readings.encode("pico", _READING) | readings.encode_status("pico", _STATUS)


def _device(key: str, data: bytes) -> None:
    """What teleoperation makes of a device's sample with one of its parts replaced; for every device alike."""
    ear = DeviceSubscriber(Shelf(_SAMPLE | {key: data}), "pico")  # type: ignore[arg-type]
    heard_of = ear.poll()
    codec.json_object({"why_not": heard_of.why_not, "sample": heard_of.number})
    if heard_of.sample is not None:
        for array in readings._arrays(heard_of.sample).values():
            assert np.isfinite(array @ array.T).all(), "too large to calculate with"
        assert all(np.isfinite(value * value) for value in heard_of.sample.controls.values())


def _robot_side(key: str, data: bytes) -> None:
    shelf = Shelf({
        keys.command_gate(ROBOT): dumped(GATE), keys.command_used(ROBOT): codec.f64(np.zeros(35)), keys.ESTOP: b"0",
    } | {key: data})  # fmt: skip
    side = RobotSide(shelf, ROBOT, 35)  # type: ignore[arg-type]
    for _ in range(2):
        side.poll(time.monotonic_ns())
        side.begin(time.monotonic_ns())
    codec.json_object({"why_not": side.why_blocked, "left": side.left, "arming": side.arming})
    if side.used is not None:
        assert np.isfinite(side.used).all(), "no command begins where the robot cannot be"


# ---- numbers ----


def _row(data: bytes) -> None:
    row = timing_row(data)
    if row is not None:
        np.array(row, dtype=np.int64)


def _live(data: bytes) -> None:
    """What a viewer is sent of any key, with the value and with the stamp that bytes are."""
    mark = stamp.decode(data)
    for key in (keys.robot_state(ROBOT), keys.command_gate(ROBOT), keys.EVENT, keys.lidar_cloud("top"), "stranger"):
        live = LiveKey(key, contracts.contract(key), "station.Fuzz")
        sample = Sample(key, data, mark, None, clocks.Offset(NOW_NS, 1_000))
        written_ns = written_wall_ns(sample, SYSTEM)
        assert 0 <= written_ns < 1 << 63
        sent = live.encode(sample, written_ns)
        assert sent is None or len(sent) == len(live.topics)
        assert sent is None or live.topics[0].encoding != "json" or isinstance(json.loads(sent[0]), dict)


def _columns(kind: Any, data: bytes) -> None:
    numbers = vectors.decoder(kind)(data)
    if numbers is not None:
        np.array([numbers], dtype=np.int64 if kind == "integer" else np.float64)


def _typed(data: bytes) -> None:
    shape = Shape()
    for value in (json.loads(dumped(GATE)), codec.parse_facts(data)):
        shape.learn(value)
    contract = contracts.contract(keys.command_gate(ROBOT))
    assert contract is not None
    channel = Channel(id=1, topic=contract.key, source="", writer="foreign", encoding="json", contract=contract)
    found = siblings(contract, shape, "station.Fuzz")
    if not isinstance(found, str):
        found.encode(Message(contract.key, data, 1, 1, 1, channel))


def _script_time(data: bytes) -> None:
    before = os.environ.get("STATION_RESTARTS")
    os.environ["STATION_RESTARTS"] = "1"
    try:
        now_s(Shelf({keys.server_config("fake"): data}))  # type: ignore[arg-type]
    finally:
        if before is None:
            del os.environ["STATION_RESTARTS"]


def _pictured(data: bytes) -> None:
    camera = MujocoCamera.__new__(MujocoCamera)
    camera._key, camera._numbers, camera.drops = keys.sim_qpos(ROBOT), 36, Drops()
    qpos = camera._parsed(Sample(camera._key, data, None, 1))
    assert qpos is None or np.isfinite(qpos).all()


def _calibrated(data: bytes) -> None:
    from station.cli.calibrate_operator import _source

    _source(Shelf({keys.server_config("pico"): data}), "pico")  # type: ignore[arg-type]


# ---- all of them ----

FORMATS = (twist.FORMAT, twist2.FORMAT, arm_command("kassow", arm_limits.load("kassow", "kr810")))
_BODY, _LIFE, _OPERATOR, _EPISODE = "station.bus.", "station.life.", "station.operator.", "station.episode."


def _scripted(key: str, data: bytes) -> None:
    shelf: Any = Shelf({
        keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG), keys.command_gate(ROBOT): dumped(GATE),
        keys.RECORDER: dumped(RECORDER), key: data,
    })  # fmt: skip
    lab = Station.__new__(Station)
    lab._bus, lab._clock, lab._contracts, lab.record = shelf, SYSTEM, None, Record(shelf)
    for robot in lab.robots():
        lab.description(robot.name)
    lab.record.status()
    value = lab.read(key)
    assert value is not None
    for reading in (value.vector, value.named, value.json):
        with contextlib.suppress(UsageError):
            reading()


def _each(what: str, parse: Callable[[str, bytes], object], module: str, values: Mapping[str, bytes]) -> list[Parser]:
    """Return a parser of each key, or kind, that reads values by what they are called."""
    return [Parser(f"{what} {key}", partial(parse, key), (value,), (module,)) for key, value in values.items()]


def _by_itself() -> list[Parser]:
    return [
        Parser("json", codec.parse_json, (dumped(CONFIG), dumped(GATE)), (_BODY + "codec",), (codec.BadValue,)),
        Parser("facts", codec.parse_facts, (dumped(CONFIG),), (_BODY + "codec",)),
        Parser("vector f64", codec.parse_f64, (codec.f64(np.ones(7)),), (_BODY + "codec",), (codec.BadValue,)),
        Parser("vector f32", codec.parse_f32, (codec.f32(np.ones(7)),), (_BODY + "codec",), (codec.BadValue,)),
        Parser("envelope, stated", lambda data: stated_envelopes({"envelopes": [data.decode(errors="replace")]}),
               (stated(ENVELOPE).encode(),), ("station.control.envelope",), (ConfigError,)),
        Parser("depth", depth.decoded, (depth.encoded(np.eye(8, dtype=np.uint16)),), ("station.depth",)),
        Parser("stamp", _stamped, (STAMP, b"1 2 3 a.b.c.d"), (
            _BODY + "stamp", _BODY + "client", _BODY + "watch", "station.view.status", _EPISODE + "storage.channels",
            _EPISODE + "storage.pictures", _EPISODE + "recorder.tap_reader", _EPISODE + "recorder.resume",
            _EPISODE + "recorder.controller")),
    ]  # fmt: skip


def _stops() -> list[Parser]:
    return [
        Parser("stop", _stop, (b"0", b'{"stop": true, "who": "ada", "reason": "so", "arm": true}', b"1"), (
            _LIFE + "estop", "station.control.command_receiver", "station.control.low_level",
            "station.supervision.stop_memory",
            "station.control.stop_trace", _LIFE + "stop_file")),
        Parser("stop, kept", _kept_stop, (dumped(KEPT_STOP),), (_LIFE + "stop_file",)),
        Parser("write that was not mirrored", not_mirrored.decode, (b'{"command":"SWAPDB","key":"a","count":1}',),
               (_BODY + "tap.not_mirrored",)),
        Parser("stop, told", _look_on, (b'{"stop": true, "reason": "so"}',), (_OPERATOR + "station_monitor",)),
    ]  # fmt: skip


def _requests() -> list[Parser]:
    return [
        Parser("arm request", partial(parse, kind=arm_request.ArmRequest, what="an arm request"),
               (b'{"action": "arm", "id": "1", "server": "g1", "who": "ada", "late_s": 0.5}',),
               (_LIFE + "request",), (Refused,)),
        Parser("arm answer", arm_request._gate, (dumped(GATE),), (_LIFE + "arm_request",)),
        Parser("arm, which robot", partial(_robot_of, keys.server_config("g1")), (dumped(CONFIG),),
               (_LIFE + "arm_request",), (NotReady,)),
        Parser("controller request", partial(parse, kind=controller_request.ControllerRequest, what="one"),
               (b'{"action": "throttle", "id": "1", "robot": "a", "profile": "b", "throttle": 3, "late_s": 1}',),
               (_LIFE + "request",), (Refused,)),
        Parser("controller answer", partial(controller_request._answer, asked="1"), (dumped(GATE),),
               (_LIFE + "controller_request",)),
        Parser("policy request", partial(parse, kind=policy_request.PolicyRequest, what="one"),
               (b'{"policy": "b", "id": "1", "robot": "a", "who": "ada", "late_s": 1}',),
               (_LIFE + "request",), (Refused,)),
        Parser("policy answer", partial(policy_request._answer, asked="1"), (dumped(GATE),),
               (_LIFE + "policy_request",)),
        Parser("policies of a robot", partial(_policies_of, keys.server_config("g1")), (dumped(CONFIG),),
               (_LIFE + "policy_request",), (NotReady,)),
        Parser("runbook status", runbook_request.decode_status, (dumped(RUNBOOK),), (_LIFE + "runbook_request",)),
        Parser("runbook answer", partial(parse, kind=runbook_request.AnswerRequest, what="one"),
               (b'{"question": "a", "answer": "yes", "who": "ada", "where": "console", "id": "1", "late_s": 1}',),
               (_LIFE + "request", "station.supervision.runbook_publisher"), (Refused,)),
        Parser("line of a stop", stop_line.parse, (b"stop ada, it smokes",), (_LIFE + "stop_line",)),
        Parser("answer to a stop", stop_line.decode_reply,
               (b'{"told": ["g1"], "not_told": ["kassow"], "why_not": "a"}\n',), (_LIFE + "stop_line",)),
        Parser("twin request", partial(parse, kind=twin_request.TwinRequest, what="one"),
               (b'{"faults": {"gantry": "slack"}, "is_well": true, "id": "1", "server": "a", "late_s": 1}',),
               (_LIFE + "request", "servers.robot_twin"), (Refused,)),
        Parser("twin answer", partial(twin_request._answer, asked="1"), (health(), dumped({"detail": {"changed": {}}})),
               (_LIFE + "twin_request",)),
        Parser("servers wanted on a machine", partial(parse, kind=hosts.Wanted, what="one"), (dumped(WANTED),),
               (_LIFE + "request", "station.supervision.agent"), (Refused,)),
        Parser("servers of a machine", _host_facts, (dumped({"name": "host-a", "detail": {"version": "1", "servers": {
               "g1": {"process": 1, "pid": 2, "code": -9}}, "free_gb": 1.5}}),), ("station.supervision.hosts",)),
        Parser("log of another machine", agent.decode_log,
               (b'{"process": 1, "first": 3, "lines": ["a", "b"], "wall_ns": 5}',), ("station.supervision.agent",)),
        Parser("motion switcher", _motion_switcher, (_SWITCHER_ANSWER, _SWITCHER_ANSWER[:28]),
               ("adapters.robots.g1.dds.words",)),
        Parser("stop, obeyed", stop_button._gate, (dumped(GATE),), (_LIFE + "stop_button",)),
        Parser("motion request", _motion_control, (b'{"action": "seek", "time_s": 1.5, "on": true}', b"1"),
               ("station.motion.playback_requests",)),
        Parser("record request", _record_request, (dumped(REQUEST),), (_EPISODE + "storage.request",), (Refused,)),
        Parser("record answer", lambda data: parse_answer(data, "a-1"), (dumped(ANSWER),), (
            _EPISODE + "storage.request", _EPISODE + "recorder.remote")),
    ]  # fmt: skip


def _measured(data: bytes) -> object:
    contract = contracts.contract(keys.robot_state(ROBOT))
    assert contract is not None
    return measuring._rows(contract, Sample(contract.key, data, None, None))


def _told() -> list[Parser]:
    return [
        Parser("event", _event, (EVENT.encode(),), (_LIFE + "events", _LIFE + "event_feed", "station.enrich.siblings")),
        Parser("heartbeat", _heartbeat, (health(),), (
            _LIFE + "server", "station.supervision.supervisor", "station.supervision.doctor", "station.view.status")),
        Parser("clock of a machine", _clock, (CLOCK,), ("station.bus.clocks",)),
        Parser("recorder's state", _record_state, (dumped(RECORDER),), (_OPERATOR + "requests",)),
        Parser("recorded event", _noted, (EVENT.encode(),), (_EPISODE + "writing.summary",)),
        Parser("recorded value", encoding_of, (dumped(GATE), b"x"), (_EPISODE + "storage.channels",)),
        Parser("timing", _row, (TIMING,), (_EPISODE + "reading.steps",)),
        Parser("typed fields", _typed, (dumped(GATE), dumped(CONFIG)),
               ("station.enrich.enrich", "station.enrich.siblings")),
        Parser("what a live viewer is sent", _live, (
            dumped(GATE), EVENT.encode(), cloud(1), codec.f64(np.ones(65)), b"1 2 3 a.b.c.d 4"),
            ("station.enrich.live",)),
        Parser("robot's description", _described, (dumped(CONFIG), dumped({"description": DESCRIPTION})),
               ("station.bus.contracts", "station.description", "servers.foxglove")),
        Parser("robot's state", partial(robot_state, contracts.contract(keys.robot_state(ROBOT))),
               (codec.f64(np.ones(65)),), (_EPISODE + "reading.steps",)),
        Parser("drawn", _drawn, (dumped(CONFIG), EVENT.encode(), dumped(SOURCE), dumped(GATE)),
               ("station.view.phases", "station.view.live")),
        Parser("what a page says", _said_by_a_page, (b'{"id": "1", "what": "record.stop", "success": true}',),
               ("station.web.pages", "station.web.sockets"), (msgspec.ValidationError,)),
        Parser("page of a server", pair.page_of, (
            dumped(CONFIG | {"url": "http://a:1/"}), dumped({"device": {"page": "b"}})), ("station.cli.pair",)),
        Parser("frame of a headset's page", _page_frame, (webxr_frame.packed(parts=24, taken_ms=1.0, sent_ms=2.0),),
               ("adapters.devices.webxr.frame",), (webxr_frame.BadFrame,)),
        Parser("a fake's time", _script_time, (dumped(CONFIG),), (_OPERATOR + "script_time",)),
        Parser("what a camera draws", _pictured, (codec.f64(np.ones(36)),), ("adapters.cameras.mujoco_robot",)),
        Parser("calibrated from", _calibrated, (dumped(CONFIG),), ("station.cli.calibrate_operator",)),
        Parser("log line", lambda data: logs._object("g1", data.decode(errors="replace")), (dumped(GATE), b"I a: b"),
               ("station.cli.logs",)),
        Parser("measured", _measured, (codec.f64(np.ones(65)),), ("station.supervision.measuring",), (NotReady,)),
        Parser("progress, an arm's", _arm_progress, (health(), b'{"a": 1}'), ("station.view.progress",)),
    ]  # fmt: skip


def _for_pages() -> list[Parser]:
    values = {
        keys.command_gate(ROBOT): dumped(GATE), keys.robot_state(ROBOT): codec.f64(np.ones(65)),
        keys.command_used(ROBOT): codec.f64(np.ones(35)), keys.RECORDER: dumped(RECORDER), keys.ESTOP: b"1",
        keys.RUNBOOK: dumped(RUNBOOK), keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG),
    }  # fmt: skip
    of = ("station.web.look", "station.web.drawn_robot", "station.view.poses")
    return [Parser(f"console {key}", partial(_console, key), (value,), of) for key, value in values.items()]


def _by_key() -> list[Parser]:
    told = {keys.server_config("g1"): dumped(CONFIG), keys.command_gate(ROBOT): dumped(GATE)}
    commands = [
        Parser(
            f"command {found.key}", partial(_command, found), (codec.json_vector(found.default),),
            ("station.control.command_validator", _BODY + "codec"),
        )
        for found in FORMATS
    ]  # fmt: skip
    return [
        *commands,
        *_each("column", _columns, _EPISODE + "reading.vectors", {
            "json-vector": TIMING, "integer": b"1795000000000", "f64": codec.f64(np.ones(7)),
            "f32": codec.f32(np.ones(7)),
        }),
        *_each("recorder hears", _heard, _EPISODE + "writing.servers_seen", {
            keys.server("g1"): health(), keys.server_config("g1"): dumped(CONFIG),
            keys.command_source(ROBOT): dumped(SOURCE),
        }),
        *_each("device", _device, _OPERATOR + "sample", _SAMPLE),
        *_each("robot's side", _robot_side, _OPERATOR + "robot_side", {
            keys.command_gate(ROBOT): dumped(GATE), keys.command_used(ROBOT): codec.f64(np.zeros(35)),
            keys.ESTOP: b'{"stop": false}',
        }),
        *_each("progress", _progress, "station.view.progress", told | {
            keys.server("g1"): health(), keys.server_config("motion"): dumped(CONFIG),
            keys.command_source(ROBOT): dumped(SOURCE), keys.policy_timing(ROBOT): TIMING,
            keys.sim_qpos(ROBOT): codec.f64(np.ones(36)), keys.RECORDER: dumped(RECORDER),
        }),
        *_each("doctor", _doctor, "station.supervision.doctor", told | {
            keys.RECORDER: dumped(RECORDER), keys.ESTOP: b'{"stop": true}',
        }),
        *_each("of a script,", _scripted, "station.api.live", told | {
            keys.robot_state(ROBOT): codec.f64(np.ones(3)), keys.RECORDER: dumped(RECORDER),
            keys.server("g1"): health(), twist_keys.action_body(): codec.json_vector([0.1] * 35),
        }),
    ]  # fmt: skip


def _natnet() -> list[Parser]:
    """What a device makes of datagrams; no value of the bus, but bytes that anybody in a network may send."""
    lengths = of_height(1.7)
    body, actor = standing(lengths), Actor(person.described(lengths))
    rows = person.seen(body.positions[None], body.quats_wxyz[None], is_local=True)[0]

    def seen(version: wire.Version, data: bytes) -> None:
        for bones in wire.frame(wire.opened(data)[1], version).skeletons.values():
            found = actor.body(bones)
            assert found is None or np.isfinite(found.positions).all()

    def described(version: wire.Version, data: bytes) -> None:
        for skeleton in wire.descriptions(wire.opened(data)[1], version):
            Actor(skeleton)

    modules, promise = ("adapters.devices.natnet.wire", "adapters.devices.natnet.actor"), (wire.BadPacket, NotAPerson)
    info = packets.server_info((4, 1), wire.DATA_PORT, "")
    parsers = [Parser("natnet server", lambda data: wire.server_info(wire.opened(data)[1]), (info,), modules, promise)]
    for version in wire.VERSIONS:
        name = f"natnet {version[0]}.{version[1]}"
        frame = packets.frame(1, {person.ID: rows}, 1.0, version)
        told = packets.descriptions((person.described(lengths),), version)
        parsers.append(Parser(f"{name} frame", partial(seen, version), (frame,), modules, promise))
        parsers.append(Parser(f"{name} descriptions", partial(described, version), (told,), modules, promise))
    return parsers


@cache
def _recording() -> rr.RecordingStream:
    """One for all values: each has two dozen threads, which nothing ends."""
    recording = rr.RecordingStream("fuzz")
    recording.save(os.devnull)
    return recording


def _lidars() -> list[Parser]:
    """What is made of clouds: of the bus, and of messages that anybody in a network may send."""
    value = cloud(1, 12)
    message = ros_messages.write_cloud(point_cloud.decoded(value), width=6, padding=4)
    sample = ros_messages.write_imu(ros_messages.Imu((0.1, 0.2, 0.3), (0.0, 0.0, -9.8), 5), "top")
    bad = (point_cloud.BadCloud,)

    def seen(data: bytes) -> None:
        found = point_cloud.decoded(data)
        assert np.isfinite(point_cloud.voxels(point_cloud.xyz(found))).all()
        point_cloud.records(found)

    def drawn(data: bytes) -> None:
        log_cloud(_recording(), keys.lidar_cloud("top"), data, ("torso",))

    def came(data: bytes) -> None:
        seen(point_cloud.encoded(ros_messages.parse_cloud(data)))

    def packed(data: bytes) -> None:
        packet = livox_packets.parse(data)
        if packet.type == livox_packets.IMU:
            livox_packets.imu_of(packet)
        else:
            seen(point_cloud.encoded(livox_packets.cloud_of([packet])))

    return [
        Parser("point cloud", seen, (value,), ("station.point_cloud",), bad),
        Parser("point cloud, drawn", drawn, (value,), ("station.view.clouds",)),
        Parser("point cloud of a network", came, (message,), ("adapters.lidars.ros_messages",), bad),
        Parser(
            "lidar's packet",
            packed,
            (next(livox_packets.write_points(Room(1920).cloud(10**9))), livox_packets.write_imu([0.1] * 6, 1, 1)),
            ("adapters.lidars.livox_packets",),
            bad,
        ),
        Parser("IMU of a network", ros_messages.parse_imu, (sample,), ("adapters.lidars.ros_messages",), bad),
    ]


def _told_to_their_policy(data: bytes) -> None:
    shelf: Any = Shelf({keys.robot_state(ROBOT): data, keys.command_gate(ROBOT): data})
    robot = lcm_server.OurRobot.__new__(lcm_server.OurRobot)
    robot._watch, robot._state_key, robot._gate_key = shelf, keys.robot_state(ROBOT), keys.command_gate(ROBOT)
    if (state := robot._state()) is not None:
        homie.robot_messages(state, is_pressed=robot._is_armed())
    robot._is_armed()


def _lcm() -> list[Parser]:
    """Datagrams of LCM, which anybody in a network may send."""

    def came(data: bytes) -> None:
        found = lcm_packet.Assembler().push(data, "somebody", 0.0)
        if found is not None:
            lcm_types.COMMAND.decode(found[1])

    message = lcm_types.COMMAND.encode({"command": (0.5, 0.0, 0.1, 0.74)})
    valid = (lcm_packet.datagrams(1, "pedal_command", message)[0], *lcm_packet.datagrams(2, "long", bytes(150_000))[:2])
    modules = ("adapters.lcm.packet", "adapters.lcm.message")
    return [
        Parser("LCM's datagram", came, valid, modules, (lcm_packet.BadPacket, BadMessage)),
        Parser("what a policy over LCM is told", _told_to_their_policy, (codec.f64(np.ones(65)), dumped(GATE)),
               ("servers.lcm",)),
    ]  # fmt: skip


def _zeromq() -> list[Parser]:
    """Messages of bridges over ZeroMQ and Zenoh, of whoever publishes where they are connected to."""

    def ordered(data: bytes) -> None:
        sonic_planner.order_of(sonic_message.parse(sonic_planner.COMMAND, data))

    def planned(data: bytes) -> None:
        found = sonic_planner.planned_of(sonic_message.parse(sonic_planner.PLANNER, data))
        sonic_planner.PlannedVelocity(has_height=True).command(found, 0.0)

    def posed(data: bytes) -> None:
        sonic_pose.PosedMotion().command(sonic_pose.frame_of(sonic_message.parse(sonic_pose.POSE, data)))

    def asked(data: bytes) -> None:
        pose_server.PosedRobot().command(pose_server.parse_pose(data).qpos, 0.0)

    def accepted(data: bytes) -> None:
        stamp.decode(data[:512])
        for each in described:
            why_not_as_described(data, each)

    described = [found for key in ("action_velocity_g1_29", "command_gate_g1_29", "policy_obs_g1_29")
                 if (found := contracts.contract(key)) is not None]  # fmt: skip
    ahead, bad = (1.0, 0.0, 0.0), (sonic_message.BadMessage,)
    order = sonic_planner.Order(start=True, stop=False, is_planner=True)
    qpos = np.array([0, 0, 0.8, 1, 0, 0, 0, *twist2.FORMAT.default[6:]], np.float32).tobytes()
    modules = ("adapters.sonic.message",)
    return [
        Parser(
            "value of a peer", accepted, (b"[0.3, 0.0, 0.1]", b'{"state": "tracking"}', np.zeros(8).tobytes()),
            ("servers.zenoh", "station.control.foreign_stream"),
        ),
        Parser("SONIC's order", ordered, (sonic_planner.pack_order(order),), modules, bad),
        Parser(
            "SONIC's plan", planned, (sonic_planner.pack_planned(sonic_planner.Planned(1, ahead, ahead, 0.5)),),
            (*modules, "adapters.sonic.planner"), bad,
        ),
        Parser(
            "SONIC's pose", posed, (sonic_pose.StreamedPose().pack(twist2.FORMAT.default, 0.02),),
            (*modules, "adapters.sonic.pose"), bad,
        ),
        Parser(
            "motion_tracking's pose", asked, (b'{"start": true, "num_frames": 1, "qpos_size": 36}\0' + qpos,),
            ("adapters.pose_server",), (pose_server.BadPose,),
        ),
        Parser(
            "motion_tracking's question", lambda data: pose_server.parse_question(data) and None,
            (b'{"start": true}',), ("adapters.pose_server",), (pose_server.BadPose,),
        ),
        Parser(
            "motion_tracking's buttons", lambda data: pose_server.parse_buttons(data) and None,
            (b'{"t_ms": 1, "controller_buttons": {"right_key_one": true, "left_key_one": false}}',),
            ("adapters.pose_server",), (pose_server.BadPose,),
        ),
    ]  # fmt: skip


def _ros2() -> list[Parser]:
    """Messages of a ROS 2 graph, which anybody in its domain may send, and values that become some."""
    pilla, go2 = (ros2_table.read(f"builtin:ros2/{name}.yaml") for name in ("pilla-policy", "go2"))
    heard = [*pilla.subscribe, *go2.subscribe]
    intakes = {row.topic: Intake(row) for row in heard}
    joints = ros_messages_of_bags.JOINT_STATE
    names = [f"joint_{number}" for number in range(1, 13)]
    numbers = (np.array(each, np.float64) for each in ([0.1] * 12, [], []))
    valid = {
        "/joint_commands": ros_types.cdr(ros_types.make(joints, ros_types.header(1), names, *numbers)),
        "/cmd_vel": ros2_told.STOPPED,
    }

    def take(topic: str, data: bytes) -> None:
        intakes[topic].take(Frame(b"m", 0, 0, 0, 0, data), 1, 0.0)

    imu = next(row for row in go2.publish if row.kind == "imu")
    tell = ros2_told.teller(imu, contracts.contract(imu.key))
    modules = ("adapters.ros2.heard", "adapters.ros2.cdr", "servers.ros2")
    return [
        *(Parser(f"ROS 2's {topic}", partial(take, topic), (data,), modules) for topic, data in valid.items()),
        Parser("a state for ROS 2", lambda data: tell(data, 1), (bytes(8 * 31),), ("adapters.ros2.told",)),
    ]


PARSERS = [
    *_by_itself(),
    *_stops(),
    *_requests(),
    *_told(),
    *_by_key(),
    *_for_pages(),
    *_natnet(),
    *_lidars(),
    *_lcm(),
    *_zeromq(),
    *_ros2(),
]
