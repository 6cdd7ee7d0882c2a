"""The stream of TWIST2's robot, sent by a real ZeroMQ publisher as that sends it."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator

import pytest
import zmq

from adapters.cameras.zmq_stream import ZmqCamera
from station.camera.source import Camera, CameraError, Picture, PictureSettings
from tests.adapters.cameras import pictures
from tests.waiting import wait_until


def message(file: bytes, *, length: int | None = None) -> bytes:
    return struct.pack("iii", 160, 120, len(file) if length is None else length) + file


class Sender:
    """The robot's side."""

    def __init__(self) -> None:
        self._socket: zmq.Socket[bytes] = zmq.Context.instance().socket(
            zmq.XPUB
        )  # a publisher that hears who subscribes
        self._socket.setsockopt(zmq.LINGER, 0)
        self.port: int = self._socket.bind_to_random_port("tcp://127.0.0.1")

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def wait_for_reader(self, read: Callable[[], object]) -> None:
        def is_heard() -> bool:
            read()
            return bool(self._socket.poll(0))

        wait_until(is_heard)
        self._socket.recv()

    def send(self, *messages: bytes) -> None:
        for each in messages:
            self._socket.send(each)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def sender() -> Iterator[Sender]:
    made = Sender()
    yield made
    made.close()


@pytest.fixture
def camera(sender: Sender) -> Iterator[ZmqCamera]:
    made = ZmqCamera(sender.address, PictureSettings())
    sender.wait_for_reader(lambda: made.read(0.01))
    yield made
    made.close()


def next_of(camera: ZmqCamera) -> Picture:
    picture = camera.read(30.0)
    assert picture is not None, camera.why_silent()
    return picture


def test_a_picture_is_passed_on_byte_for_byte_and_counts_as_taken_when_it_arrives(
    sender: Sender, camera: ZmqCamera
) -> None:
    assert isinstance(camera, Camera)
    before_ns = time.monotonic_ns()
    sender.send(message(pictures.jpeg(5)))
    picture = next_of(camera)
    assert picture.jpeg == pictures.jpeg(5)
    assert before_ns <= picture.capture_ns <= time.monotonic_ns()
    assert (camera.facts()["width"], camera.facts()["height"]) == (160, 120)


def test_of_several_that_wait_the_newest_is_given(sender: Sender, camera: ZmqCamera) -> None:
    sender.send(*(message(pictures.jpeg(number)) for number in range(5)))
    seen = [next_of(camera)]
    while pictures.number(seen[-1].jpeg) != 4:  # they may come in two goes
        seen.append(next_of(camera))
    assert camera.drops.skipped == 5 - len(seen)


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        (message(pictures.jpeg(1), length=17), "a message says 17 bytes and has"),
        (message(pictures.jpeg(1)[:-40]), "holds no whole JPEG file"),
        (b"short", "a message of 5 bytes; expected width, height, length and a JPEG file"),
    ],
)
def test_a_message_that_is_none_is_left_out_counted_and_explained(
    sender: Sender, camera: ZmqCamera, sent: bytes, told: str
) -> None:
    sender.send(sent)
    wait_until(lambda: (camera.read(0.1), camera.drops.torn)[1])
    assert told in camera.why_silent()
    sender.send(message(pictures.jpeg(2)))
    assert pictures.number(next_of(camera).jpeg) == 2


def test_a_sender_that_is_not_there_is_waited_for(sender: Sender) -> None:
    camera = ZmqCamera(sender.address, PictureSettings())
    sender.close()
    assert camera.read(0.05) is None
    assert "nothing comes; does the sender run" in camera.why_silent()
    camera.close()
    camera.close()


def test_what_the_sender_decides_cannot_be_wished_for() -> None:
    with pytest.raises(CameraError, match="the sender decides on size and rate; leave out width, height and fps"):
        ZmqCamera("tcp://127.0.0.1:5555", PictureSettings(fps=30.0))


def test_an_address_that_is_none_is_refused_at_once() -> None:
    with pytest.raises(CameraError, match=r"expected an address such as tcp://192\.168\.123\.164:5555"):
        ZmqCamera("127.0.0.1:5555", PictureSettings())
