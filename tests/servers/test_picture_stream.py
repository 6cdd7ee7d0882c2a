"""TWIST2's picture stream: its readers get a camera's pictures byte for byte, and are told nothing that is old."""

from __future__ import annotations

import contextlib
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from adapters.cameras.zmq_stream import ZmqCamera
from servers.picture_stream import PictureStreamConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.camera.source import PictureSettings
from station.config import build
from station.errors import ConfigError
from tests.adapters.cameras import pictures
from tests.servers.bridge_station import BridgeStation, free_port

KEY = keys.camera_image("head")


@pytest.fixture
def stream(bus_server: BusAddress, tmp_path: Path) -> Iterator[BridgeStation]:
    with contextlib.closing(BridgeStation("picture-stream", bus_server, tmp_path)) as made:
        yield made


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="head", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def address() -> str:
    return f"tcp://127.0.0.1:{free_port()}"


class StockClient:
    """Reads as TWIST2's client does: one part, twelve bytes of head, dropped where the length is another."""

    def __init__(self, address: str) -> None:
        self._socket = zmq.Context.instance().socket(zmq.SUB)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt_string(zmq.SUBSCRIBE, "")
        self._socket.connect(address)
        self.files: list[bytes] = []
        self.sizes: set[tuple[int, int]] = set()

    def hear(self) -> list[bytes]:
        with contextlib.suppress(zmq.Again):
            while True:
                message = self._socket.recv(zmq.NOBLOCK)
                assert not self._socket.getsockopt(zmq.RCVMORE)
                width, height, length = struct.unpack("iii", message[:12])
                assert length == len(message) - 12
                self.sizes.add((width, height))
                self.files.append(message[12:])
        return self.files

    def close(self) -> None:
        self._socket.close()


def test_two_readers_get_the_cameras_pictures_byte_for_byte(stream: BridgeStation, bus: Bus, address: str) -> None:
    stream.start(camera="head", address=address)
    ours = ZmqCamera(address, PictureSettings())
    with contextlib.closing(StockClient(address)) as theirs, contextlib.closing(ours):
        sent, seen = [], []

        def both_have_some() -> bool:
            sent.append(pictures.jpeg(len(sent)))
            bus.publish({KEY: sent[-1]}, capture_ns=time.monotonic_ns())
            if (picture := ours.read(0.02)) is not None:
                seen.append(picture.jpeg)
            return len(theirs.hear()) > 20 and len(seen) > 20

        stream.until(both_have_some)
        assert theirs.sizes == {(160, 120)}
        numbers = [pictures.number(file) for file in theirs.files]
        assert numbers == sorted(numbers)
        assert set(theirs.files) <= set(sent)
        assert set(seen) <= set(sent)
        stream.until(lambda: stream.detail["sent"] >= len(theirs.hear()) and stream.told("picture-stream-heard"))
        assert 0.0 <= stream.detail["age_ms"] < 1000.0
        stream.until(lambda: stream.told("picture-stream-silent"))
    assert stream.interrupt() == 0


def test_what_is_sent_is_what_is_counted_and_every_picture_is_sent_or_said_why_not(
    stream: BridgeStation, bus: Bus, address: str
) -> None:
    stream.start(camera="head", address=address)
    bus.publish({KEY: pictures.jpeg(1)})
    stream.until(lambda: stream.detail["dropped"].get("nobody hears it") == 1)
    with contextlib.closing(StockClient(address)) as theirs:
        stream.until(lambda: stream.told("picture-stream-heard"))
        bus.publish({KEY: b"\xff\xd8 no picture"})
        stream.until(lambda: stream.detail["dropped"].get("no JPEG file") == 1)
        for number in range(200):
            bus.publish({KEY: pictures.jpeg(number)})
        stream.until(
            lambda: (told := stream.detail)["sent"] + sum(told["dropped"].values()) == 202 and told["sent"] > 0
        )
        stream.until(lambda: len(theirs.hear()) == stream.detail["sent"])


READER = """
import sys, time, zmq
socket = zmq.Context.instance().socket(zmq.SUB)
socket.setsockopt_string(zmq.SUBSCRIBE, "")
socket.connect(sys.argv[1])
time.sleep(1000)
"""


def test_pictures_that_wait_for_a_frozen_reader_are_few_and_the_others_are_counted(
    stream: BridgeStation, bus: Bus, address: str
) -> None:
    stream.start(camera="head", address=address)
    big = pictures.jpeg(1, 1600, 1200) + bytes(500_000)  # padding behind the end is allowed
    with subprocess.Popen([sys.executable, "-c", READER, address]) as reader:
        stream.until(lambda: stream.told("picture-stream-heard"))
        reader.send_signal(signal.SIGSTOP)

        def is_full() -> bool:
            bus.publish({KEY: big})
            return stream.detail["dropped"].get("who hears it does not read", 0) > 5

        stream.until(is_full)
        assert stream.detail["sent"] < 40, "what the kernels of both sides hold, and two"
        reader.kill()


def test_a_stream_that_was_killed_and_is_started_again_is_heard_again(
    stream: BridgeStation, bus: Bus, address: str
) -> None:
    with contextlib.closing(StockClient(address)) as theirs:
        for _ in range(2):
            stream.start(camera="head", address=address)
            before = len(theirs.files)
            stream.until(lambda: [bus.publish({KEY: pictures.jpeg(2)})] and len(theirs.hear()) > before)  # noqa: B023
            stream.process.kill()
            stream.process.wait()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"camera": "Head Cam"}, "camera is 'Head Cam'; expected small letters"),
        ({"address": "tcp://*:5555"}, "listens on every network"),
        ({"address": "tcp://192.168.123.164"}, r"expected an address such as tcp://127\.0\.0\.1:5556"),
        ({"niceness": 20}, "expected 0 to 19"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(PictureStreamConfig, settings, where="test")
