"""The socket: real UDP with LCM's own library as a peer, what is heard of whom, and damaged datagrams."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from adapters.lcm import types
from adapters.lcm.message import BadMessage
from adapters.lcm.multicast import GROUP, Multicast, Received
from adapters.lcm.packet import Assembler, BadPacket, datagrams
from station.errors import StationError
from tests.adapters.lcm.library import expect_library, sample
from tests.adapters.lcm.loopback import multicast_loopback
from tests.tiers import ROOT
from tests.waiting import wait_until


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@pytest.fixture
def port(processes: None) -> int:
    return free_port()


@pytest.fixture
def heard(port: int) -> Iterator[Multicast]:
    with contextlib.closing(Multicast(port=port)) as made:
        yield made


@pytest.fixture
def sending(port: int) -> Iterator[Multicast]:
    with contextlib.closing(Multicast(port=port)) as made:
        yield made


def until_heard(by: Multicast, count: int) -> list[Received]:
    found: list[Received] = []

    def has_come() -> bool:
        found.extend(by.receive(0.05))
        return len(found) >= count

    wait_until(has_come)
    return found


def test_messages_of_lcms_own_library_are_read_and_it_reads_ours(processes: None) -> None:
    expect_library()
    with multicast_loopback() as inside:
        words = [*inside, sys.executable, "-m", "tests.adapters.lcm.exchange", "7667"]
        done = subprocess.run(words, check=False, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"to us": True, "to them": True, "count": [21, 21]}


def test_a_member_hears_the_others_and_not_itself(port: int, heard: Multicast, sending: Multicast) -> None:
    with contextlib.closing(Multicast(port=port)) as third:
        sending.send("a", b"short")
        sending.send("b", bytes(200_000))
        for member in (heard, third):
            found = [(each.channel, len(each.message), each.sender) for each in until_heard(member, 2)]
            assert found == [("a", 5, sending.address), ("b", 200_000, sending.address)]
    assert list(sending.receive(0.0)) == []


def test_a_message_is_as_old_as_it_lay_in_the_kernel(heard: Multicast, sending: Multicast) -> None:
    sending.send("a", b"old")
    time.sleep(0.3)
    (found,) = until_heard(heard, 1)
    assert (time.monotonic_ns() - found.arrived_ns) * 1e-9 >= 0.29


def test_another_computer_than_the_one_that_is_named_is_not_heard(port: int, sending: Multicast) -> None:
    with contextlib.closing(Multicast(port=port, peer="127.0.0.9")) as strict:
        sending.send("a", b"short")
        wait_until(lambda: list(strict.receive(0.05)) or strict.dropped)
        assert strict.dropped == {"another computer": 1}


def test_nothing_leaves_the_computer_and_other_interfaces_are_not_heard(heard: Multicast, port: int) -> None:
    assert heard._own.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
    assert heard._heard.getsockname() == (GROUP, port)
    assert heard._heard.getsockopt(socket.IPPROTO_IP, 49) == 0


def test_an_address_that_this_computer_does_not_have_is_one_line(port: int) -> None:
    with pytest.raises(StationError, match=r"cannot be joined on 192\.0\.2\.7: .*; name with interface=") as caught:
        Multicast(port=port, interface="192.0.2.7")
    assert "\n" not in str(caught.value)


def test_a_message_that_cannot_be_sent_ends_nobody(port: int) -> None:
    gone = Multicast(port=port)
    gone.close()
    assert gone.send("a", b"short") == "Bad file descriptor"


def test_ten_thousand_damaged_datagrams_reach_nothing_and_end_nothing(heard: Multicast, port: int) -> None:
    rng = random.Random(3)
    good = datagrams(1, "pedal_command", types.COMMAND.encode(sample(types.COMMAND)))[0]
    parts = datagrams(2, "pedal_command", bytes(150_000))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anybody:
        anybody.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for number in range(2000):
            anybody.sendto(damaged(rng, rng.choice([good, parts[1]])), (GROUP, port))
            if number % 50 == 0:
                assert not [each for each in heard.receive(0.0) if is_command(each)]
        anybody.sendto(good, (GROUP, port))
    wait_until(lambda: [each for each in heard.receive(0.05) if is_command(each)])
    assert heard.dropped["not LCM"] > 100
    assembler, taken = Assembler(), 0
    for number in range(10_000):
        with contextlib.suppress(BadPacket):
            message = assembler.push(damaged(rng, rng.choice([good, *parts])), number % 20, number * 0.001)
            taken += message is not None and is_command(Received(*message, ("", 0), 0))
    assert taken == 0


def damaged(rng: random.Random, datagram: bytes) -> bytes:
    """Return a datagram cut, lengthened, made up, or with other bytes in its head, its channel or its fingerprint."""
    way = rng.randrange(4)
    if way == 0:
        return datagram[: rng.randrange(len(datagram))]
    if way == 1:
        return datagram + rng.randbytes(rng.randint(1, 40))
    if way == 2:
        return rng.randbytes(rng.randrange(100))
    data = bytearray(datagram)
    data[rng.choice([*range(4), *range(8, 30)])] ^= rng.randint(1, 255)
    return bytes(data)


def is_command(received: Received) -> bool:
    """Whether it would be taken for a command of the pedals."""
    if received.channel != "pedal_command":
        return False
    try:
        types.COMMAND.decode(received.message)
    except BadMessage:
        return False
    return True
