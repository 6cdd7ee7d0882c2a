"""A headset through the real library, under a PC service of ours on the loopback interface."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.pico.controls import CONTROLS
from adapters.devices.pico.kind import controller_data
from station.operator.sample import OperatorSample
from tests.adapters.devices.pico.frames import IDENTITY, body, controller, frame, hand, head
from tests.adapters.devices.pico.wearing import Wearer, wearing

MS = 1_000_000
HALF = np.sqrt(0.5)


@pytest.fixture
def service() -> Iterator[PicoService]:
    with PicoService(0) as service:
        yield service


@pytest.fixture(scope="module")
def worn(processes: None) -> Iterator[Wearer]:
    """A headset that is worn for all tests: the library takes half a second to connect, and another to let go."""
    with PicoService(0) as service, wearing(service) as wearer:
        yield wearer


@pytest.fixture
def wearer(worn: Wearer) -> Wearer:
    worn.begin()
    return worn


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


def test_a_metre_forward_is_x_and_a_turn_to_the_left_is_yaw(wearer: Wearer) -> None:
    """The headset's forward is -z, its right +x, its up +y; a turn to the left is positive about up."""
    sample = wearer.after(frame(1 * MS, Head=head(f"0.2,0.5,-1,0,{HALF},0,{HALF}")))
    assert sample["capture_ns"] == 1 * MS
    assert sample["head"] == pytest.approx([1.0, -0.2, 0.5, HALF, 0.0, 0.0, HALF])


def test_every_control_has_its_own_value(wearer: Wearer) -> None:
    left = controller(f"0,0,0,{IDENTITY}", trigger=0.1, grip=0.2, axisX=-0.3, axisY=0.4, primaryButton=True)
    right = controller(f"0,0,-1,{IDENTITY}", trigger=0.5, grip=0.6, axisX=0.7, axisY=-0.8, secondaryButton=True)
    left |= {"menuButton": True}
    right |= {"axisClick": True}
    sample = wearer.after(frame(1 * MS, Controller={"left": left, "right": right}))
    expected = dict.fromkeys(CONTROLS, 0.0) | {
        "left_trigger": 0.1, "left_grip": 0.2, "left_stick_x": -0.3, "left_stick_y": 0.4, "left_primary": 1.0,
        "left_menu": 1.0, "right_trigger": 0.5, "right_grip": 0.6, "right_stick_x": 0.7, "right_stick_y": -0.8,
        "right_secondary": 1.0, "right_stick_click": 1.0,
    }  # fmt: skip
    assert sample["controls"] == pytest.approx(expected)
    assert sample["right"] == pytest.approx([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def test_the_body_comes_joint_by_joint_and_only_while_its_own_stamp_moves(wearer: Wearer) -> None:
    poses = [f"0,{joint},0,{IDENTITY}" for joint in range(24)]
    first = wearer.after(frame(1000 * MS, Body=body(7, poses)))
    assert first["body"]["positions"] == pytest.approx(np.outer(np.arange(24.0), [0.0, 0.0, 1.0]))
    assert first["body"]["quats_wxyz"] == pytest.approx(np.tile([1.0, 0.0, 0.0, 0.0], (24, 1)))
    assert wearer.after(frame(1090 * MS))["body"] is not None, "one frame without it is no loss"
    assert wearer.after(frame(1101 * MS))["body"] is None, "the library goes on giving the last one for ever"
    assert wearer.after(frame(1200 * MS, Body=body(8, poses)))["body"] is not None


def test_hands_come_when_active_and_while_they_are_tracked(wearer: Wearer) -> None:
    hands = {"leftHand": hand(f"0,0,-1,{IDENTITY}"), "rightHand": hand(f"0,0,0,{IDENTITY}", is_active=0)}
    first = wearer.after(frame(1000 * MS, Hand=hands))
    assert first["hands"] == {"left": [pytest.approx([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])] * 26}
    assert "left" in wearer.after(frame(1400 * MS))["hands"]
    assert wearer.after(frame(1501 * MS))["hands"] == {}


def test_controllers_that_are_tracked_no_more_have_no_pose_and_no_buttons(wearer: Wearer) -> None:
    pressed = {side: controller(f"0,0,0,{IDENTITY}", primaryButton=True) for side in ("left", "right")}
    first = wearer.after(frame(1000 * MS, Controller=pressed))
    assert first["controls"]["right_primary"] == 1.0
    gone = wearer.after(frame(1501 * MS, Controller=None))
    assert (gone["left"], gone["right"], gone["controls"]) == (None, None, {})
    assert gone["head"] is not None
    assert wearer.after(frame(1600 * MS))["right"] is not None


def test_a_pose_of_zeros_is_no_pose(wearer: Wearer) -> None:
    sample = wearer.after(frame(1 * MS, Head=head("0,0,0,0,0,0,0")))
    assert sample["head"] is None


def test_a_frame_with_the_same_stamp_is_no_new_sample(wearer: Wearer) -> None:
    assert wearer.after(frame(1 * MS))["capture_ns"] == 1 * MS
    wearer.send(frame(1 * MS, Head=head(f"0,1,0,{IDENTITY}")))
    assert wearer.after(frame(2 * MS))["capture_ns"] == 2 * MS


def test_a_torn_frame_is_lost_and_the_next_one_comes(wearer: Wearer) -> None:
    wearer.send(frame(1 * MS, Controller={"left": {"pose": f"0,0,0,{IDENTITY}"}, "right": {}}))
    while wearer.after(frame(3 * MS))["capture_ns"] != 3 * MS:  # the torn one may count, by its stamp
        pass


@pytest.mark.usefixtures("processes")
def test_it_comes_back_with_a_service_that_was_away_for_too_short_to_be_noticed(service: PicoService) -> None:
    with wearing(service, patience_s=0.2) as wearer:
        wearer.after(frame(1 * MS))
        service.stop()
        service.start()
        assert wearer.until_one_comes(frame(2 * MS))["capture_ns"] >= 2 * MS


@pytest.mark.usefixtures("processes")
def test_opening_closing_and_leaving_are_safe_and_nothing_of_the_library_is_on_stdout() -> None:
    """Each of these ends the process where the library is used as it comes."""
    done = python(
        "from adapters.devices.pico.headset import Headset\n"
        "from station.operator.device import Device, DeviceError\n"
        "first = Headset(port=1)\n"
        "assert isinstance(first, Device)\n"
        "try: Headset(port=1)\n"
        "except DeviceError as error: print(error)\n"
        "first.close(); first.close()\n"
        "second = Headset(port=1)\n"
        "print(second.read(), second.facts()['service'])\n"
        "print(second.why_silent())\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "this process has a Pico headset already; the library allows one, so close that first",
        "None 127.0.0.1:1",
        "no headset yet: no PC service answers at 127.0.0.1:1; start XRoboToolkit's PC Service there",
    ]


@pytest.mark.usefixtures("processes")
def test_a_service_without_a_headset_is_told_from_no_service(service: PicoService) -> None:
    done = python(
        f"from adapters.devices.pico.headset import Headset\nprint(Headset(port={service.port}).why_silent())\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"no headset yet: the PC service at 127.0.0.1:{service.port} has none; in the")


@pytest.mark.usefixtures("processes")
def test_a_missing_library_is_one_line_with_the_extra_to_install() -> None:
    done = python(
        "import sys; sys.modules['xrobotoolkit_sdk'] = None\n"
        "from adapters.devices.pico.headset import Headset\n"
        "try: Headset()\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    assert done.stdout.startswith("DeviceError a Pico headset needs xrobotoolkit-sdk")
    assert "pip install 'teleop-station[pico]'" in done.stdout
    assert len(done.stdout.splitlines()) == 1


def test_stock_data_have_every_key_that_stock_readers_ask_for() -> None:
    data = controller_data(
        OperatorSample(capture_ns=5, controls={"left_trigger": 0.5, "left_secondary": 1.0, "right_stick_y": -1.0})
    )
    at_rest = {"index_trig": 0.0, "grip": 0.0, "key_one": False, "key_two": False, "axis": [0.0, 0.0],
               "axis_click": False}  # fmt: skip
    assert data == {
        "LeftController": at_rest | {"index_trig": 0.5, "key_two": True},
        "RightController": at_rest | {"axis": [0.0, -1.0]},
        "timestamp": 5,
    }
