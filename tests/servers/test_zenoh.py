"""The Zenoh bridge beside a peer of Zenoh's library: keys go out with their stamps, accepted ones come in checked."""

from __future__ import annotations

import contextlib
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from servers.zenoh import ZenohConfig
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import build
from station.errors import ConfigError
from tests.servers.bridge_station import BridgeStation, free_port

STATE = keys.robot_state("g1_29")
WALK = keys.action("velocity_g1_29")
FAR = keys.action("velocity_go2")


class Peer:
    """A peer that connects to the bridge, or listens itself."""

    def __init__(self, endpoint: str, *, listens: bool = False) -> None:
        there = f'["{endpoint}"]'
        config = zenoh.Config()
        for name, value in {
            "mode": '"peer"', "connect/endpoints": "[]" if listens else there,
            "listen/endpoints": there if listens else "[]",
            "scouting/multicast/enabled": "false", "scouting/gossip/enabled": "false",
            "connect/timeout_ms": "-1", "connect/exit_on_failure": "false",
        }.items():  # fmt: skip
            config.insert_json5(name, value)
        self.session = zenoh.open(config)
        self.heard: dict[str, list[tuple[bytes, stamp.Stamp | None]]] = defaultdict(list)
        self._kept: list[object] = []

    def subscribe(self, key: str) -> None:
        self._kept.append(self.session.declare_subscriber(key, self._keep))

    def put(self, key: str, value: bytes, mark: bytes = b"") -> None:
        self.session.put(key, value, attachment=mark, congestion_control=zenoh.CongestionControl.BLOCK)

    def close(self) -> None:
        self.session.close()

    def _keep(self, sample: zenoh.Sample) -> None:
        mark = b"" if sample.attachment is None else sample.attachment.to_bytes()
        self.heard[str(sample.key_expr)].append((sample.payload.to_bytes(), stamp.decode(mark)))


@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[BridgeStation]:
    with contextlib.closing(BridgeStation("zenoh", bus_server, tmp_path)) as made:
        yield made


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="robot", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


def own_stamp(seq: int, *, age_s: float = 0.0) -> bytes:
    """Return the stamp of a writer on this machine."""
    mono_ns = time.monotonic_ns() - round(age_s * 1e9)
    return stamp.Stamp(seq, mono_ns, time.time_ns(), f"rio.1.{stamp.boot_id()}.abcd").encode()


def test_keys_that_match_go_out_byte_for_byte_with_the_stamps_of_the_bus(
    bridge: BridgeStation, bus: Bus, endpoint: str
) -> None:
    bus.publish({STATE: b"before", "other": b"x"})
    bridge.start(publish=["robot_state_*", "camera_image_head"], listen=endpoint)
    with contextlib.closing(Peer(endpoint)) as peer:
        peer.subscribe("**")
        bridge.until(lambda: bridge.told("zenoh-heard"))
        sent = [b"\0\xff %d" % number for number in range(200)]
        for value in sent:
            bus.publish({STATE: value, "other": value})
            time.sleep(0.002)
        bridge.until(lambda: peer.heard[STATE] and peer.heard[STATE][-1][0] == sent[-1])
        assert set(peer.heard) == {STATE}
        got = [value for value, _ in peer.heard[STATE]]
        assert got == [value for value in sent if value in set(got)], "in order, each once, and none of before"
        assert all(mark is not None and mark.writer == "robot" for _, mark in peer.heard[STATE])
        bridge.until(
            lambda: (told := bridge.detail["published"])["sent"] + told["dropped"].get("overwritten", 0) == 200
        )
        assert bridge.detail["published"]["sent"] == len(got)
        bus.publish({keys.camera_image("head"): bytes(900_000)})
        time.sleep(0.6)  # a new key is found within half a second
        bus.publish({keys.camera_image("head"): bytes(900_000)})
        bridge.until(lambda: peer.heard[keys.camera_image("head")])
    bridge.until(lambda: bridge.told("zenoh-not-heard"))
    bus.publish({STATE: b"later"})
    bridge.until(lambda: bridge.detail["published"]["dropped"].get("nobody hears it"))
    assert bridge.interrupt() == 0


def test_a_peer_that_comes_and_goes_in_haste_is_heard_by_what_it_did_last(
    bridge: BridgeStation, bus: Bus, endpoint: str
) -> None:
    bus.publish({STATE: b"before"})
    bridge.start(publish=["robot_state_*"], listen=endpoint)
    with contextlib.closing(Peer(endpoint)) as peer:
        for _ in range(30):
            peer.session.declare_subscriber(STATE, lambda _: None).undeclare()
        peer.subscribe(STATE)
        bridge.until(lambda: [bus.publish({STATE: b"last"})] and peer.heard[STATE])
        peer.session.declare_subscriber(STATE, lambda _: None).undeclare()
        count = len(peer.heard[STATE])
        bridge.until(lambda: [bus.publish({STATE: b"one more"})] and len(peer.heard[STATE]) > count + 5)


def test_accepted_keys_come_in_where_they_hold_what_their_contract_says(bridge: BridgeStation, endpoint: str) -> None:
    bridge.start(accept=[WALK, "rio/left_arm"], listen=endpoint)
    with contextlib.closing(Peer(endpoint)) as peer:
        good = codec.json_vector([0.5, 0.0, 0.1])

        def put(key: str, value: bytes) -> bool:
            peer.put(key, value)
            return True

        bridge.until(lambda: put(WALK, good) and len(bridge.written[WALK]) > 20)
        for value, kind in {
            codec.json_vector([0.5]): "wrong-length", b"[0.1, 0.2, NaN]": "not-finite", b"\x80": "bad-value",
            pickle.dumps([0.1, 0.2, 0.3]): "bad-value", b"[1e999, 0, 0]": "not-finite",
        }.items():  # fmt: skip
            bridge.until(
                lambda value=value, kind=kind: put(WALK, value) and bridge.detail["keys"][WALK]["dropped"].get(kind)
            )
        assert set(bridge.written[WALK]) == {good}
        anything = pickle.dumps({"nobody": "reads it"})
        bridge.until(lambda: put("rio/left_arm", anything) and bridge.written["rio/left_arm"])
        assert bridge.written["rio/left_arm"][0] == anything, "no contract, byte for byte"
        assert put(FAR, good)
        assert put("station:estop", b'{"stop": true}')
        bridge.until(lambda: bridge.told("zenoh-silent"))
        assert FAR not in bridge.written
        bridge.until(lambda: put(WALK, good) and bridge.told("zenoh-back"))


def test_a_value_is_as_old_as_its_stamp_says_and_a_gap_in_the_count_is_told(
    bridge: BridgeStation, endpoint: str
) -> None:
    bridge.start(accept=[WALK], listen=endpoint)
    with contextlib.closing(Peer(endpoint)) as peer:
        good, seq = codec.json_vector([0.5, 0.0, 0.1]), iter(range(1, 10_000))
        bridge.until(lambda: [peer.put(WALK, good, own_stamp(next(seq)))] and bridge.written[WALK])
        bridge.until(lambda: bridge.told("zenoh-live"))
        assert bridge.told("zenoh-live")[0].detail["sender"] == "rio"
        bridge.until(
            lambda: (
                [peer.put(WALK, good, own_stamp(next(seq), age_s=0.5))]
                and bridge.detail["keys"][WALK]["dropped"].get("stale")
            )
        )
        missing = bridge.detail["missing"]
        for _ in range(7):
            next(seq)
        bridge.until(lambda: [peer.put(WALK, good, own_stamp(next(seq)))] and bridge.detail["missing"] > missing)
        assert bridge.detail["missing"] == missing + 7


def test_what_came_in_does_not_go_out_again(bridge: BridgeStation, endpoint: str) -> None:
    bridge.start(publish=["action_*"], accept=[WALK], listen=endpoint)
    with contextlib.closing(Peer(endpoint)) as peer:
        good = codec.json_vector([0.5, 0.0, 0.1])
        bridge.until(lambda: [peer.put(WALK, good)] and len(bridge.written[WALK]) > 5)
        peer.subscribe(WALK)
        bridge.until(lambda: bridge.told("zenoh-heard"))
        heard = len(peer.heard[WALK])
        passed = len(bridge.written[WALK])
        bridge.until(lambda: [peer.put(WALK, good)] and len(bridge.written[WALK]) > passed + 20)
        own = [mark for _, mark in peer.heard[WALK][heard:] if mark is not None]
        assert own == [], "only the peer's own, which have no stamp"


def test_a_bridge_that_was_killed_and_is_started_again_finds_its_peer(
    bridge: BridgeStation, bus: Bus, endpoint: str
) -> None:
    with contextlib.closing(Peer(endpoint)) as peer:
        peer.subscribe(STATE)
        for _ in range(2):
            bridge.start(publish=["robot_state_*"], listen=endpoint)
            heard = len(peer.heard[STATE])
            bridge.until(lambda: [bus.publish({STATE: b"x"})] and len(peer.heard[STATE]) > heard + 5)  # noqa: B023
            bridge.process.kill()
            bridge.process.wait()


FROZEN = """
import sys, time, zenoh
config = zenoh.Config()
for name, value in {"mode": '"peer"', "connect/endpoints": '["%s"]' % sys.argv[1], "listen/endpoints": "[]",
                    "scouting/multicast/enabled": "false"}.items():
    config.insert_json5(name, value)
session = zenoh.open(config)
kept = session.declare_subscriber("**", lambda sample: None)
time.sleep(1000)
"""


def test_a_peer_that_is_frozen_or_killed_holds_up_no_other_work_and_what_it_missed_is_counted(
    bridge: BridgeStation, bus: Bus, endpoint: str
) -> None:
    bridge.start(publish=["camera_image_*"], accept=[WALK], listen=endpoint)
    image = keys.camera_image("head")
    bus.publish({image: b"x"})
    with subprocess.Popen([sys.executable, "-c", FROZEN, endpoint]) as frozen:
        bridge.until(lambda: bridge.told("zenoh-heard"))
        frozen.send_signal(signal.SIGSTOP)

        def is_overwritten() -> bool:
            bus.publish({image: bytes(900_000)})
            return bridge.detail["published"]["dropped"].get("overwritten", 0) > 10

        bridge.until(is_overwritten)
        with contextlib.closing(Peer(endpoint)) as peer:
            good = codec.json_vector([0.5, 0.0, 0.1])
            bridge.until(lambda: [peer.put(WALK, good)] and bridge.written[WALK])
        frozen.kill()
    bridge.until(lambda: [bus.publish({image: b"x"})] and bridge.told("zenoh-not-heard"))
    assert bridge.interrupt() == 0


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({}, "publish and accept are empty: nothing would pass"),
        ({"publish": ["a"], "listen": ""}, "listen and connect are empty"),
        ({"publish": ["a"], "listen": "127.0.0.1:7447"}, "expected an endpoint such as tcp/127.0.0.1:7447"),
        ({"publish": ["a"], "listen": "tcp/0.0.0.0:7447"}, "that is every network"),
        ({"publish": ["a"], "connect": ["udp/x"]}, "connect is 'udp/x'"),
        ({"accept": ["action_*"]}, "expected names without patterns"),
        ({"accept": ["action_x@"]}, "is no key"),
        ({"accept": ["station:estop"]}, "commands the station itself, which no stranger may"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(ZenohConfig, settings, where="test")


def test_a_port_that_is_taken_ends_it_with_what_to_do(bridge: BridgeStation) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        bridge.launch(publish=["a"], listen=f"tcp/127.0.0.1:{taken.getsockname()[1]}")
        code, words = bridge.ends()
    assert code == 1
    assert "Address already in use" in words
    assert "--set listen=" in words
