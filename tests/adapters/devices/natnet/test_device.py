"""The device on real sockets, with a server that does what a test says, step by step, and a clock by hand."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import numpy as np
import pytest

from adapters.devices.fakes.natnet import packets, person
from adapters.devices.natnet import wire
from adapters.devices.natnet.device import Natnet
from adapters.retarget.human import INDEX, of_height, standing
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample
from tests.adapters.devices.by_hand import HandClock

LENGTHS = of_height(1.75)


class Server:
    """Motive, by hand; `asked` is what it was asked, in order."""

    def __init__(self, address: str = "127.0.0.1") -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind((address, 0))
        self.port = self.socket.getsockname()[1]
        self.version: wire.Version = (4, 1)
        self.actors = [("Ada", 7)]
        self.asked: list[int] = []
        self.number = 0
        self._client = ("127.0.0.1", 9)

    def answer(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self._client = self.socket.recvfrom(100)
                self.asked.append(wire.opened(data)[0])
                if self.asked[-1] == wire.CONNECT:
                    self.send(packets.server_info(self.version, 1511, ""))
                elif self.asked[-1] == wire.REQUEST_DESCRIPTIONS:
                    described = (person.described(LENGTHS, name, id_) for name, id_ in self.actors)
                    self.send(packets.descriptions(tuple(described), self.version))

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, self._client)

    def show(self, time_s: float, *, tracked: bool = True, actor: int = 7, shift_m: float | None = None) -> None:
        self.send(self.frame(time_s, tracked=tracked, actor=actor, shift_m=shift_m))

    def frame(self, time_s: float, *, tracked: bool = True, actor: int = 7, shift_m: float | None = None) -> bytes:
        self.number += 1
        body = standing(LENGTHS)
        positions = body.positions + np.array([0.001 * self.number if shift_m is None else shift_m, 0.0, 0.0])
        rows = person.seen(positions[None], body.quats_wxyz[None], is_local=True)[0]
        rows["flags"] = tracked
        return packets.frame(self.number, {actor: rows}, time_s, self.version)


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.socket.close()


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def device(server: Server, clock: HandClock) -> Iterator[Natnet]:
    with contextlib.closing(Natnet(port=server.port, clock=clock)) as made:
        yield made


def met(device: Natnet, server: Server, clock: HandClock) -> None:
    """Let the device learn who the server is, which skeletons it has, and where they are."""
    for _ in range(3):
        server.answer()
        device.read()
        clock.pass_(0.01)


def body_of(sample: OperatorSample | None) -> object:
    assert sample is not None
    return sample.body


def test_the_newest_of_many_frames_counts_with_the_time_of_its_exposure(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    met(device, server, clock)
    for number in range(20):
        server.show(5.0 + 0.01 * number)
    sample = device.read()
    assert sample is not None
    assert sample.capture_ns == 5_190_000_000
    assert sample.body is not None
    assert sample.body.positions[INDEX["head"]][0] == pytest.approx(0.02, abs=1e-5)
    assert sample.controls == {}
    assert device.read() is None, "once"
    assert device.facts() | {"server": ""} == {
        "server": "", "actor": "the only one", "application": "Fake Motive 3.1", "natnet": "4.1",
    }  # fmt: skip


def test_without_motive_it_says_where_it_looked_and_goes_on_asking(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    assert device.why_silent().startswith(f"no Motive answers at 127.0.0.1:{server.port}; start it there")
    for _ in range(3):
        clock.pass_(1.01)
        assert device.read() is None
    met(device, server, clock)
    assert server.asked.count(wire.CONNECT) >= 4
    server.show(1.0)
    assert body_of(device.read()) is not None


def test_it_asks_once_a_second_to_be_kept_and_anew_when_frames_cease(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    met(device, server, clock)
    server.asked.clear()
    for number in range(300):
        clock.pass_(0.01)
        server.show(0.01 * number)
        device.read()
    server.answer()
    assert server.asked == [wire.KEEP_ALIVE] * 3
    server.asked.clear()
    for _ in range(3):
        clock.pass_(1.01)
        device.read()
    server.answer()
    assert server.asked.count(wire.CONNECT) >= 2
    assert "sends no frames" in device.why_silent()


def test_a_motive_that_was_started_anew_with_another_version_is_met_again(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    met(device, server, clock)
    server.show(100.0)
    assert body_of(device.read()) is not None
    server.version, server.actors = (3, 1), [("Bea", 9)]
    for _ in range(2):
        clock.pass_(1.01)
        device.read()
    met(device, server, clock)
    server.show(2.0, actor=9)
    sample = device.read()
    assert sample is not None, "its clock begins anew"
    assert (sample.capture_ns, sample.body is not None) == (2_000_000_000, True)


def test_a_frame_that_comes_late_is_dropped(device: Natnet, server: Server, clock: HandClock) -> None:
    met(device, server, clock)
    server.show(5.0)
    assert device.read() is not None
    server.show(4.9)
    assert device.read() is None
    server.show(5.0)
    assert device.read() is None


def test_an_actor_who_is_lost_or_gone_is_no_body_and_the_device_lives(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    met(device, server, clock)
    server.show(1.0, tracked=False)
    assert body_of(device.read()) is None
    server.show(1.1, actor=8)
    assert body_of(device.read()) is None
    server.asked.clear()
    server.answer()
    assert wire.REQUEST_DESCRIPTIONS in server.asked, "it may be described by another number now"
    server.show(1.2)
    assert body_of(device.read()) is not None


def test_bones_that_stand_to_the_last_bit_are_no_body(device: Natnet, server: Server, clock: HandClock) -> None:
    met(device, server, clock)
    for time_s, is_body in ((1.0, True), (1.05, True), (1.1, True), (1.11, False), (1.2, False)):
        server.show(time_s, shift_m=0.3)
        assert (body_of(device.read()) is not None) is is_body, time_s
    server.show(1.21, shift_m=0.301)
    assert body_of(device.read()) is not None


def test_what_cannot_be_read_is_counted_told_and_over_with_the_next_good_frame(
    device: Natnet, server: Server, clock: HandClock
) -> None:
    met(device, server, clock)
    whole = server.frame(1.0)
    for data in (b"", b"\x07", whole[: len(whole) // 2], b"\x07\x00\x04\x00\xff\xff\xff\xff"):
        server.send(data)
    assert device.read() is None
    assert device.why_silent().startswith("4 packets could not be read, the last because of ")
    server.show(1.1)
    assert body_of(device.read()) is not None
    assert device.why_silent() == ""


def test_packets_of_others_are_not_listened_to(device: Natnet, server: Server, clock: HandClock) -> None:
    met(device, server, clock)
    stranger = Server("127.0.0.2")
    stranger._client = server._client
    stranger.show(1.0)
    assert device.read() is None
    server.show(1.0)
    assert device.read() is not None
    stranger.socket.close()


def test_of_two_actors_one_must_be_named(server: Server, clock: HandClock) -> None:
    server.actors = [("Ada", 7), ("Bea", 9)]
    with contextlib.closing(Natnet(port=server.port, clock=clock)) as device:
        met(device, server, clock)
        assert device.why_silent() == "2 actors there: Ada, Bea; name one with actor=…"
        server.show(1.0)
        assert device.read() is None
    for name, why in (("Bea", ""), ("Cy", "no actor 'Cy' there, but Ada, Bea; switch on Skeletons")):
        with contextlib.closing(Natnet(port=server.port, clock=clock, actor=name)) as device:
            met(device, server, clock)
            server.show(2.0, actor=9)
            assert (device.read() is not None) is (not why)
            assert device.why_silent() == why


@pytest.mark.parametrize("version", [(2, 10), (4, 2), (5, 0)])
def test_another_version_is_refused_in_a_line(
    device: Natnet, server: Server, clock: HandClock, version: wire.Version
) -> None:
    server.version = version
    server.answer()
    told = rf"Fake Motive 3.1 speaks NatNet {version[0]}.{version[1]}; understood: 3.0, 3.1, 4.0, 4.1; set one of them"
    with pytest.raises(DeviceError, match=told):
        device.read()


def test_an_address_that_is_not_ours_is_told_in_a_line(clock: HandClock) -> None:
    with pytest.raises(DeviceError, match=r"natnet: 192.0.2.1 cannot be listened to: .*; name this computer's address"):
        Natnet("192.0.2.2", "192.0.2.1", clock=clock)


def test_frames_to_a_group_are_heard_by_who_joins_it(server: Server, clock: HandClock) -> None:
    group = "239.255.42.99"
    server.socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        data_port = free.getsockname()[1]
    with contextlib.closing(Natnet(port=server.port, group=group, data_port=data_port, clock=clock)) as device:
        met(device, server, clock)
        server.socket.sendto(server.frame(1.0), (group, data_port))
        assert body_of(device.read()) is not None
