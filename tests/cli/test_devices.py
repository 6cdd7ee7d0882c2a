"""``station devices``: what is there, fakes of it, buttons and calibration, as a user types it."""

from __future__ import annotations

import contextlib
import json
import math
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import SERVOS, Chain, wrapped
from adapters.devices.fakes.glove.port import FakePort as GlovePort
from adapters.devices.gello.bus import RAD_PER_TICK, Servos
from adapters.devices.gello.calibration import QUARTER, load
from adapters.devices.gello.device import Gello
from adapters.devices.glove import calibration as gloves
from adapters.devices.pico.headset import DEFAULT_PORT
from station import registry
from station.bus.address import BusAddress
from tests.cli.at_terminal import AtTerminal
from tests.cli.running import Home, Running, one_line
from tests.main_job.station_runs import ROOT
from tests.waiting import DEADLINE_S, wait_until

DEVICES = ["g1-remote", "gamepad", "gello", "glove", "keyboard", "natnet", "pico", "spacemouse", "webxr"]
CAMERAS = ["files", "mujoco", "realsense", "uvc", "zmq"]
PROBLEM = "lab arm at /dev/lab: permission denied; join the group lab"
LAB = f"""
from pathlib import Path
from station.operator.device import DeviceError
from station.operator.device_kind import DeviceKind

def plugged_in():
    raise DeviceError({PROBLEM!r})

def kind(name, library, example=Path("x.json"), plugged_in=plugged_in):
    return DeviceKind(name=name, about="an arm", library=library, extra="lab", example=example,
                      plugged_in=plugged_in, source=None,
                      controls=["pedal", "knob"], buttons=dict(engage="pedal", estop="knob"))

ARM, HAND = kind("lab-arm", "numpy"), kind("lab-hand", "no-such-package")
KNOB = kind("lab-knob", "", None, list)
"""


@pytest.fixture
def lab(home: Home, tmp_path: Path) -> Home:
    """A home with a third-party package: one device without permission to open it, one whose library is missing."""
    (tmp_path / "lab_devices.py").write_text(LAB)
    facts = tmp_path / "lab_devices-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-devices\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(
        "[station.devices]\nlab-arm = lab_devices:ARM\nlab-hand = lab_devices:HAND\nlab-knob = lab_devices:KNOB\n"
    )
    home.environment["PYTHONPATH"] = str(tmp_path)
    return home


def cells(table: str) -> dict[str, list[str]]:
    """Rows of a table by their first cell, below its titles."""
    rows = [re.split(r"\s{2,}", line.strip()) for line in table.splitlines()[1:]]
    return {row[0]: row[1:] for row in rows}


def words(home: Home, *arguments: str) -> str:
    done = home.run("devices", *arguments)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_is_registered_under_its_own_name_with_an_example(name: str) -> None:
    kind = registry.find("device", name)
    assert kind.name == name
    assert kind.example.is_file()
    assert name in registry.names("server")


def test_the_list_says_what_reads_each_device_and_what_is_plugged_in(home: Home) -> None:
    table, cameras, *_, hint = words(home, "list").split("\n\n")  # between them what a camera's library lacks here
    rows = cells(table)
    assert list(rows) == DEVICES
    assert rows["keyboard"] == ["–", "any terminal", "keys of a terminal: discrete commands, short jogs"]
    assert rows["spacemouse"][0].startswith("hidapi ")
    assert list(cells(cameras)) == CAMERAS
    assert cells(cameras)["zmq"][1:] == ["–", "the picture stream of TWIST2's robot"]
    assert hint.startswith("to try a device without hardware: station devices fake DEVICE\n")


def test_the_list_knows_a_service_that_a_headset_may_send_to(home: Home) -> None:
    with socket.socket() as service:
        service.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # another one listens there: as good
            service.bind(("127.0.0.1", DEFAULT_PORT))
            service.listen()
        found = {each["device"]: each for each in home.json("devices", "list")}
    assert list(found) == DEVICES + CAMERAS
    assert [name for name, each in found.items() if each["role"] == "camera"] == CAMERAS
    assert found["pico"]["plugged_in"] == [f"PC service at 127.0.0.1:{DEFAULT_PORT}"]
    assert found["pico"]["library"] == "xrobotoolkit-sdk"
    assert found["keyboard"]["version"] is None
    assert {each["problem"] for each in found.values() if each["role"] == "device"} == {""}


def test_a_device_that_may_not_be_read_and_a_library_that_is_missing_are_told_with_what_to_do(lab: Home) -> None:
    table, _, *problems, install, _ = words(lab, "list").split("\n\n")
    assert cells(table)["lab-arm"][1:] == ["cannot tell", "an arm"]
    assert cells(table)["lab-hand"] == ["no no-such-package", "cannot tell", "an arm"]
    of_devices = [problem for problem in problems if not problem.startswith(tuple(CAMERAS))]
    assert of_devices == [f"lab-arm: {PROBLEM}"], "what lacks its library is told of that alone"
    assert install == "to install what is missing: pip install 'teleop-station[lab]'"


def test_a_package_that_is_broken_is_told_of_and_hides_no_other_device(lab: Home, tmp_path: Path) -> None:
    facts = tmp_path / "broken-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(
        "[station.devices]\nwheel = no_such_module:KIND\nlever = lab_devices:NOTHING\nknob2 = lab_devices:KNOB\n"
    )
    listed = words(lab, "list")
    assert {"gamepad", "lab-arm", "wheel", "lever", "knob2"} <= set(cells(listed.split("\n\n")[0]))
    assert "wheel: device 'wheel' (no_such_module:KIND) cannot be loaded: No module named 'no_such_module'" in listed
    assert "knob2: device 'knob2' calls itself 'lab-knob'; its entry point has to have the same name" in listed
    assert "lab-arm" in lab.json("devices", "buttons")
    said = one_line(lab.run("devices", "buttons", "lever"))
    assert "cannot be loaded" in said
    assert said.endswith("mend or uninstall the package that registers it")


def test_a_device_of_somebody_s_package_brings_its_buttons(lab: Home, tmp_path: Path) -> None:
    shown = cells(words(lab, "buttons", "lab-arm"))
    assert (shown["engage"][0], shown["estop"][0], shown["mark"][0]) == ("pedal", "knob", "-")
    assert {"lab-arm", "lab-hand"} <= set(lab.json("devices", "buttons"))
    changes = tmp_path / "buttons.yaml"
    changes.write_text("mark: pedla\n")
    said = one_line(lab.run("devices", "buttons", "lab-arm", "--map", str(changes)))
    assert "a lab-arm has no control 'pedla' (did you mean 'pedal'?)" in said


SHOWN = {
    "g1-remote": "left_bumper=1",
    "gamepad": "left_bumper=1",
    "keyboard": "key_enter=1",
    "spacemouse": "button_0=1",
}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "terminated"])
@pytest.mark.parametrize("device", SHOWN)
def test_an_example_is_played_until_it_is_stopped(home: Home, device: str, number: signal.Signals) -> None:
    home.environment["PYTHONUNBUFFERED"] = "1"
    with home.running("devices", "fake", device) as fake:
        wait_for_output(fake, SHOWN[device])
        fake.process.send_signal(number)
        assert fake.finish()[0] == 0
    example = registry.find("device", device).example
    assert fake.lines == [
        f"what a station makes of it; `station up` plays it with --set {device}.fake={example}, "
        f"`station serve {device}` with --set fake={example}"
    ]


UNPLUGGED = {"at_s": 3.0, "plugged": False}


@pytest.mark.parametrize(
    ("device", "step", "shown"),
    [
        ("spacemouse", {"at_s": 0.1, "buttons": [1]}, "button_1=1"),
        ("gamepad", {"at_s": 0.1, "set": {"right_primary": 1}}, "right_primary=1"),
        ("keyboard", {"at_s": 0.1, "press": "w", "for_s": 2.5}, "key_w=1"),
    ],
)
def test_what_a_script_does_is_shown_until_the_device_is_gone(
    home: Home, tmp_path: Path, device: str, step: dict[str, Any], shown: str
) -> None:
    file = tmp_path / "script.json"
    file.write_text(json.dumps({"device": device, "steps": [step, UNPLUGGED]}))
    done = home.run("devices", "fake", device, "--play", str(file))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert any(shown in line for line in lines)
    assert "gone" in lines[-1] or "was closed" in lines[-1]


def test_a_device_without_a_fake_says_so(lab: Home, bus_server: BusAddress) -> None:
    assert one_line(lab.run("devices", "fake", "lab-knob")) == "devices fake lab-knob: this device has no fake"
    said = one_line(lab.run("serve", "lab-knob", "--set", "fake=script.json", "--bus", bus_server.url))
    assert said == "lab-knob.fake is script.json; this device has no fake"


def wait_for_output(running: Running, text: str) -> str:
    assert running.process.stdout is not None
    while line := running.process.stdout.readline():
        if text in line:
            return line
    raise AssertionError(f"no {text!r}:\n{running.text}")


def test_leaders_are_found_with_the_settings_that_the_fake_prints(home: Home, tmp_path: Path) -> None:
    script = tmp_path / "held.json"
    script.write_text(json.dumps({"device": "gello", "steps": [{"at_s": 0, "right": [0.1, 0.2, 1.0]}]}))
    with home.running("devices", "fake", "gello", "--play", str(script)) as fake:
        line = wait_for_output(fake, "gello.ports=")
        port = Path(line.split("[")[1].split("]")[0])
        calibrations = Path(line.split("gello.calibrations=")[1].strip())
        device = Gello(ports_wanted=(str(port),), calibrations_folder=calibrations, by_id=port.parent)
        assert device.facts()["joints"] == ["right_joint_1", "right_joint_2", "right_gripper"]
        device.close()
        fake.interrupt()
        assert fake.finish()[0] == 0
    assert not port.parent.exists()


def test_a_fake_headset_begins_with_the_first_that_listens(home: Home) -> None:
    with home.running("devices", "fake", "pico", "--port", "0") as fake:
        fake.wait_for("waits for a pico server with --set pico.port=")
        port = fake.text.split("pico.port=")[1].split(";")[0]
        reader = [sys.executable, "-m", "tests.adapters.devices.pico.wearing", port, "60"]
        with subprocess.Popen(reader, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as worn:
            assert worn.stdout is not None
            assert json.loads(worn.stdout.readline())["head"] is not None
            worn.communicate(b"\n", timeout=DEADLINE_S)
        fake.wait_for("a server is there: ")
        fake.interrupt()
        assert fake.finish()[0] == 0


def test_a_fake_page_says_that_no_server_is_there(home: Home) -> None:
    with home.running("devices", "fake", "webxr", "--port", "1") as fake:
        fake.wait_for("not open yet: ")
        fake.wait_for("does a webxr server run? It tries again")
        fake.interrupt()
        assert fake.finish()[0] == 0


def test_buttons_are_shown_with_what_a_file_changes(home: Home, tmp_path: Path) -> None:
    assert cells(words(home, "buttons", "pico"))["estop"] == ["left_stick_click", "emergency stop, latched"]
    changes = tmp_path / "mine.yaml"
    changes.write_text("success: [right_grip, left_grip+left_trigger]\nmark: none\n")
    mine = cells(words(home, "buttons", "pico", "--map", str(changes)))
    assert mine["success"][0] == "right_grip, left_grip+left_trigger"
    assert mine["mark"][0] == "-"
    every = home.json("devices", "buttons")
    assert list(every) == ["g1-remote", "gamepad", "keyboard", "pico", "spacemouse", "webxr"]
    assert every["keyboard"]["exit"] == ["key_q"]
    assert every["spacemouse"]["mark"] == []


def test_voices_are_listed_with_what_each_lacks_and_can_be_heard(home: Home, tmp_path: Path) -> None:
    home.environment |= {"SDL_AUDIODRIVER": "alsa", "ALSA_CONFIG_PATH": "/nowhere", "PATH": str(tmp_path)}
    table, speech, tones, hint = words(home, "voices").split("\n\n")
    assert {name: row[0] for name, row in cells(table).items()} == {"speech": "no", "tones": "no", "wav": "yes"}
    assert speech.startswith("speech: no program to speak with: none of espeak-ng")
    assert tones.startswith("tones: no sound output (")
    assert hint.startswith("to hear one: station devices voices VOICE")
    said = words(home, "voices", "wav", "--words", "good morning", "--set", f"file={tmp_path}/a.wav")
    assert said == f"wav gave 'good morning'; file {tmp_path}/a.wav, volume 0.5\n"
    assert (tmp_path / "a.txt").read_text().endswith("\tgood morning\n")
    found = home.json("devices", "voices")
    assert [each["voice"] for each in found if each["missing"]] == ["speech", "tones"]


NAMES = ("base", "elbow")
OFFSETS = (2 * QUARTER, -QUARTER)
TURNS = (1, -1)
CALIBRATE = ("devices", "calibrate", "gello", "--arm", "right", "--joints", ",".join(NAMES), "--pose-deg", "0,90")


class Leader:
    """A leader arm on a pseudo terminal, moved by the test."""

    def __init__(self, folder: Path, maker: Servos) -> None:
        self.joints, self.trigger, self.maker = [0.4, 0.4], 0.5, maker
        shown = wrapped if maker == "feetech" else int
        servos = [SERVOS[maker](index + 1, lambda index=index: shown(self._ticks(index))) for index in range(3)]
        self.port = FakePort(folder, "FT7", Chain(servos))

    def _ticks(self, index: int) -> int:
        if index == len(NAMES):
            return round(math.radians(200.0 - 42.0 * self.trigger) / RAD_PER_TICK)
        return round((OFFSETS[index] + TURNS[index] * self.joints[index]) / RAD_PER_TICK)


@pytest.fixture
def leader(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Leader]:
    made = Leader(tmp_path, getattr(request, "param", "dynamixel"))
    yield made
    made.port.close()


@pytest.mark.parametrize("leader", SERVOS, indirect=True)
def test_a_leader_is_calibrated_at_a_terminal(home: Home, leader: Leader, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    where = ("--port", str(leader.port.path), "--calibrations", str(kept))
    where += () if leader.maker == "dynamixel" else ("--servos", leader.maker)
    with AtTerminal(home, *CALIBRATE, *where) as terminal:
        place = 0
        for index, name in enumerate(NAMES):
            place = terminal.wait_for(f"Turn {name} by about 30°", place)
            leader.joints[index] += 0.5
            terminal.type(b"\n")
        place = terminal.wait_for("in this pose: base 0°, elbow 90°; then Enter", place)
        leader.joints = [0.05, math.pi / 2 - 0.05]
        terminal.type(b"\n")
        place = terminal.wait_for("fully open; then Enter", place)
        leader.trigger = 0.0
        terminal.type(b"\n")
        place = terminal.wait_for("fully closed, and hold it; then Enter", place)
        leader.trigger = 1.0
        terminal.type(b"\n")
        assert terminal.finish() == 0, terminal.screen
    assert f"leader FT7 is calibrated as the right arm: {kept / 'FT7.yaml'}" in terminal.screen
    assert "will be replaced" not in terminal.screen
    made = load(kept, "FT7")
    assert [joint.sign for joint in made.joints] == list(TURNS)
    turn = {"dynamixel": 0.0, "feetech": math.tau}[leader.maker]  # whole ones are not seen
    off = [joint.offset_rad - offset for joint, offset in zip(made.joints, OFFSETS, strict=True)]
    assert [each for each in off if min(abs(each), abs(abs(each) - turn)) > 1e-6] == []
    assert {joint.model for joint in made.joints} == {SERVOS[leader.maker].usual_model}
    assert [joint.reference_rad for joint in made.joints] == pytest.approx([0.0, math.pi / 2])
    assert made.names == ("right_base", "right_elbow", "right_gripper")


def test_a_calibration_that_is_given_up_leaves_the_one_before(home: Home, leader: Leader, tmp_path: Path) -> None:
    kept = tmp_path / "FT7.yaml"
    kept.write_text("the one before")
    where = ("--port", str(leader.port.path), "--calibrations", str(tmp_path), "--signs", "1,-1")
    with AtTerminal(home, *CALIBRATE, *where) as terminal:
        terminal.wait_for("Hold the leader still in this pose")
        assert f"{kept} is there and will be replaced at the end" in terminal.screen
        terminal.type(b"\x03")
        assert terminal.finish() == 130
        wait_until(lambda: "station: interrupted" in terminal.screen)
    assert terminal.screen.splitlines()[-1] == "station: interrupted"
    assert kept.read_text() == "the one before"


def test_a_glove_is_calibrated_at_a_terminal(home: Home, tmp_path: Path) -> None:
    shown = [b"10 900 10 900 10\r\n"]
    port = GlovePort(tmp_path, "GL7", lambda: shown[0])
    kept = tmp_path / "kept"
    try:
        where = ("--side", "left", "--port", str(port.path), "--calibrations", str(kept))
        with AtTerminal(home, "devices", "calibrate", "glove", *where) as terminal:
            place = terminal.wait_for("Hold the hand flat, fingers spread and open, thumb out; then Enter")
            terminal.type(b"\n")
            terminal.wait_for("Make a fist, the thumb over the fingers, and hold it; then Enter", place)
            shown[0] = b"800 100 800 100 800\r\n"
            terminal.type(b"\n")
            assert terminal.finish() == 0, terminal.screen
    finally:
        port.close()
    assert f"glove GL7 is calibrated for the left hand: {kept / 'GL7-left.yaml'}" in terminal.screen
    made = gloves.load(kept, "GL7", "left")
    assert [(sensor.open, sensor.closed) for sensor in made.sensors][:2] == [(10.0, 800.0), (900.0, 100.0)]


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["lst"], 2, "unknown `station devices` command 'lst' (did you mean 'list'?)"),
        (["fake"], 2, "Missing argument 'DEVICE'"),
        (["fake", "pco"], 2, "unknown device 'pco' (did you mean 'pico'?); known: g1-remote, gamepad, gello, glove,"),
        (["fake", "gello", "--port", "60061"], 2, "devices fake gello: takes no --port"),
        (["fake", "pico", "--port", "70000"], 2, "70000 is not in the range 0<=x<=65535"),
        (["fake", "pico", "--play", "none.json"], 2, "none.json: cannot be read: No such file or directory"),
        (["fake", "gamepad", "--play", "none.json"], 2, "none.json: cannot be read: No such file or directory"),
        (["fake", "gello", "--play", "GAMEPAD"], 2, "is a script of a fake 'gamepad'; expected one of 'gello'"),
        (["fake", "pico", "--play", "GAMEPAD"], 2, "device: invalid enum value 'gamepad'"),
        (["voices", "horn"], 2, "unknown voice 'horn'; known: speech, tones, wav"),
        (["voices", "wav", "--set", "fiel=x"], 2, "voice wav: unknown key 'fiel' (did you mean 'file'?)"),
        (["voices", "speech", "--set", "program=sing"], 2, "program is 'sing'; expected one of espeak-ng"),
        (["buttons", "pco"], 2, "unknown device 'pco'"),
        (["buttons", "--map", "mine.yaml"], 2, "devices buttons --map: name the device"),
        (["buttons", "pico", "--map", "none.yaml"], 2, "none.yaml: no such file"),
        (["calibrate", "keyboard"], 2, "unknown `station devices calibrate` command 'keyboard'; known: gello, glove,"),
        (["calibrate", "glove"], 2, "Missing option '--side'"),
        (["calibrate", "glove", "--side", "left", "--sensors", "pinky"], 2, "--sensors: 'pinky' is no sensor"),
        (["calibrate", "glove", "--side", "left", "--port", "/dev/none"], 2, "no terminal to ask in"),
        (["calibrate", "gello", "--joints", "a"], 2, "Missing option '--arm'"),
        (["calibrate", "gello", "--servos", "feetec"], 2, "'feetec' is not one of 'dynamixel', 'feetech'"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a,,b"], 2, "--joints: expected different names"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a,b", "--pose-deg", "0"], 1, "1 numbers of the pose for"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a", "--pose-deg", "nan"], 2, "--pose-deg: expected"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a", "--signs", "pnda"], 2, "(did you mean 'panda'?)"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a", "--signs", "2"], 2, "--signs: expected 1 or -1"),
        (["calibrate", "gello", "--arm", "left", "--joints", "a", "--port", "/dev/none"], 2, "no terminal to ask in"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_a_mistake_is_one_line(home: Home, arguments: list[str], code: int, told: str) -> None:
    examples = {"GAMEPAD": str(registry.find("device", "gamepad").example)}
    done = home.run("devices", *(examples.get(word, word) for word in arguments))
    assert told in one_line(done)
    assert done.returncode == code


def test_a_port_that_is_not_there_or_in_use_is_one_line(home: Home, leader: Leader) -> None:
    with AtTerminal(home, *CALIBRATE, "--port", "/dev/none") as terminal:
        assert terminal.finish() == 1
    assert (
        terminal.screen.strip() == "station: /dev/none: no such port; plug the leader in, or name another with ports:"
    )
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert f"port {port} on 127.0.0.1 is in use" in one_line(home.run("devices", "fake", "pico", "--port", port))
