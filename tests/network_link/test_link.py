"""The cable between two computers that are network namespaces: what it carries, loses, holds back, leaves behind."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.network_link.link import INTERFACE, End, Link, why_not
from tests.network_link.probes import Probes
from tests.waiting import is_running, wait_until

ROBOT, OPERATOR = "192.168.123.164", "192.168.123.222"
MULTICAST = "239.255.0.1"  # DDS's

_SIOCGIFFLAGS, _IFF_RUNNING = 0x8913, 0x40  # linux/sockios.h, linux/if.h


@pytest.fixture(scope="module")
def link(network_links: None) -> Iterator[Link]:
    with Link((ROBOT, OPERATOR), seed=1) as laid:
        yield laid


@pytest.fixture
def plugged(link: Link) -> Link:
    """The link with nothing wrong."""
    link.plug()
    link.change()
    return link


@pytest.mark.parametrize("ends", [(0, 1), (1, 0)], ids=["from the first", "from the second"])
def test_whatever_is_sent_comes_out_at_the_other_end_once_and_in_order(plugged, ends):
    sender, receiver = (plugged.ends[number] for number in ends)
    with Probes(plugged, sender, receiver) as probes:
        probes.greet()
        probes.send(500)
        wait_until(lambda: len(probes.numbers) >= 501)
    assert probes.numbers == list(range(501))


def test_multicast_passes(plugged):
    robot, operator = plugged.ends
    with Probes(plugged, robot, operator, MULTICAST) as probes:
        probes.send(50)
        wait_until(lambda: len(probes.numbers) >= 50)
    assert probes.numbers == list(range(50))


def test_nothing_takes_less_than_the_delay_nor_overtakes(plugged):
    robot, operator = plugged.ends
    with Probes(plugged, robot, operator) as probes:
        probes.greet()
        plugged.change(delay_s=0.02)
        probes.send(20)
        probes.greet()
        assert min(arrival.took_s for arrival in probes.arrivals[1:]) >= 0.02
        plugged.change(delay_s=0.005, jitter_s=0.01)
        probes.send(200, every_s=0.001)
        probes.greet()
    assert probes.numbers == list(range(223))


def test_a_share_is_lost_of_the_direction_that_loses(plugged):
    robot, operator = plugged.ends
    with Probes(plugged, robot, operator) as there, Probes(plugged, operator, robot) as back:
        there.greet()
        back.greet()
        plugged.change(loss=0.1, out_of=robot)
        before = plugged.counts(robot)
        there.send(2000)
        after = plugged.counts(robot)
        back.send(200)
        wait_until(lambda: len(back.numbers) >= 201)
        wait_until(lambda: len(there.numbers) >= 1 + 2000 - (after.lost - before.lost))
    lost = 2001 - len(there.numbers)
    assert abs(lost - 200) < 54, "four standard deviations of 2000 draws"
    assert there.numbers == sorted(there.numbers)


@pytest.mark.parametrize("is_seen", [True, False], ids=["at the plug", "behind a switch"])
def test_nothing_passes_a_cable_that_is_pulled_and_all_does_again_once_it_is_back(plugged, is_seen):
    robot, operator = plugged.ends
    with Probes(plugged, robot, operator) as there, Probes(plugged, operator, robot) as back:
        there.greet()
        back.greet()
        plugged.change(delay_s=0.3)
        there.send(1, is_waited_for=False)  # on the way when the cable is pulled
        plugged.pull(*([operator] if is_seen else []))
        wait_until(lambda: has_carrier(operator) is not is_seen)
        assert has_carrier(robot)
        plugged.change()
        there.send(50)
        back.send(50)
        assert (len(there.numbers), len(back.numbers)) == (1, 1)
        plugged.plug()
        wait_until(lambda: has_carrier(operator))  # the kernel looks once a second
        there.greet()
        back.greet()
    assert there.numbers == [0, 52]
    if not is_seen:
        assert back.numbers == [0, 51]
    else:  # an end without a carrier forgets its neighbours, and keeps what is for them until it has found them again
        assert back.numbers == sorted(set(back.numbers))
        assert (back.numbers[0], back.numbers[-1]) == (0, 51)


def has_carrier(end: End) -> bool:
    """Whether the Ethernet device of an end sees that a cable is in it."""
    with end.socket() as any_socket:
        flags = fcntl.ioctl(any_socket, _SIOCGIFFLAGS, struct.pack("16sH22x", INTERFACE.encode(), 0))
    return bool(struct.unpack("16xH22x", flags)[0] & _IFF_RUNNING)


def test_it_tells_when_the_newest_datagram_for_a_port_was_delivered(network_links):
    with Link((ROBOT, OPERATOR), port=4711) as laid:
        robot, operator = laid.ends
        with Probes(laid, operator, robot) as probes:
            assert laid.counts(operator).last_ns == 0
            probes.greet()
            first = laid.counts(operator).last_ns
            probes.greet()
            assert laid.counts(operator).last_ns > first > 0
            assert laid.counts(robot).last_ns == 0


def test_both_ends_are_apart_from_this_machine_and_have_loopback(plugged):
    robot, operator = plugged.ends
    with robot.socket() as of_robot, robot.socket() as nearby, operator.socket() as of_operator:
        of_robot.bind(("127.0.0.1", 0))
        of_operator.bind(("127.0.0.1", of_robot.getsockname()[1]))
        nearby.sendto(b"near", of_robot.getsockname())
        of_robot.settimeout(20.0)
        assert of_robot.recv(10) == b"near"
        of_operator.setblocking(False)
        with pytest.raises(BlockingIOError):
            of_operator.recv(10)


LAID = """
import json, subprocess, sys
from tests.network_link.link import Link
with Link(("10.1.1.1", "10.1.1.2")) as link:
    guest = link.ends[0].popen(["sleep", "600"])
    print(json.dumps([link._forwarder.pid, guest.pid]), flush=True)
    guest.wait()
"""


def test_who_is_killed_leaves_neither_the_cable_nor_what_ran_at_its_ends(network_links):
    owner = subprocess.Popen([sys.executable, "-c", LAID], stdout=subprocess.PIPE, text=True)
    try:
        assert owner.stdout is not None
        pids = json.loads(owner.stdout.readline())
    finally:
        owner.send_signal(signal.SIGKILL)
        owner.communicate()
    wait_until(lambda: not any(is_running(pid) for pid in pids))


def test_a_user_who_may_not_is_told_why(network_links, monkeypatch):
    assert why_not() == ""
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "only root" in why_not()
