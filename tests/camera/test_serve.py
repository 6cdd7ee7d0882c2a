"""The loop of cameras in virtual time: a camera that falls silent, is torn out, drops; a bus that stalls."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest

from station.bus import keys, stamp
from station.camera.serve import serve_camera
from station.camera.source import Camera, CameraError, Drops, Picture
from station.life.server import Life, ServerKind
from station.life.serving import serve
from station.optics import Intrinsics, Mount, Optics, of_facts
from tests.virtual.clock import ThreadFailed, VirtualClock
from tests.virtual.network import Network
from tests.virtual.written import Log

FPS = 30.0
KEY, DEPTH = keys.camera_image("head"), keys.camera_depth("head")
UNKNOWN = Optics()
SEEDS = range(30)
OLD_S = 0.2
"""The oldest picture that goes to the bus: one period, the longest wait for an answer, and the line [s]."""


class Nothing(msgspec.Struct):
    pass


class Eye:
    """A camera whose pictures are numbers; the test silences it, tears it out and has it lose some.

    Attributes:
        tried_s: When it was looked for [s].
    """

    def __init__(self, clock: VirtualClock) -> None:
        self.drops = Drops()
        self.is_silent = self.is_there = self.has_depth = False
        self.is_there = True
        self.tried_s: list[float] = []
        self._clock, self._period_ns = clock, round(1e9 / FPS)
        self._given = -1

    def open(self) -> Camera:
        self.tried_s.append(self._clock.monotonic_s())
        if not self.is_there:
            raise CameraError("no camera; plug it in")
        return self

    def read(self, timeout_s: float) -> Picture | None:
        if not self.is_there:
            raise CameraError("the camera was torn out; plug it in")
        index, now_ns = self._index(), self._clock.monotonic_ns()
        if index == self._given or self.is_silent:
            wait_s = timeout_s if self.is_silent else min(timeout_s, ((index + 1) * self._period_ns - now_ns) * 1e-9)
            self._clock.sleep(wait_s)
            index = self._index()
        if index == self._given or self.is_silent or not self.is_there:
            return None
        self._given = index
        return Picture(b"%d" % index, index * self._period_ns, b"depth of %d" % index if self.has_depth else b"")

    def _index(self) -> int:
        return self._clock.monotonic_ns() // self._period_ns

    def why_silent(self) -> str:
        return "is its cap on?"

    def facts(self) -> dict[str, Any]:
        depth = {"depth": {"step_m": 0.001, "range_m": None, "is_aligned": True}} if self.has_depth else {}
        return {"width": 2, "height": 1, "fps": FPS, "format": "number", "device": "eye", "capture": "exact",
                "exposure": None, **depth}  # fmt: skip

    def close(self) -> None:
        pass


class Station:
    """The camera server, what it wrote, and its eye."""

    def __init__(self, clock: VirtualClock, optics: Optics = UNKNOWN, *, has_depth: bool = False) -> None:
        self.optics = optics
        self.clock, self.network, self.eye = clock, Network(clock, (20_000, 200_000)), Eye(clock)
        self.eye.has_depth = has_depth
        self.log = Log(self.network)
        self.process = clock.spawn(self._serve, "camera")

    def told(self) -> list[tuple[str, str]]:
        return [(event.name, str(event.detail.get("reason", ""))) for _, event in self.log.events()]

    def at_s(self, name: str) -> list[float]:
        return [at_s for at_s, event in self.log.events() if event.name == name]

    def ages_s(self) -> list[float]:
        """Return how old each picture was when its server wrote it, and how old when the bus had it [s]."""
        marks = [stamp.decode(write.value) for write in self.log.of(keys.stamp(KEY))]
        at_s = [write.at_s for write in self.log.of(KEY)]
        return [now_s - (mark.capture_ns or 0) * 1e-9 for now_s, mark in zip(at_s, marks, strict=True) if mark]

    def _serve(self) -> None:
        def main(_config: Nothing, life: Life) -> int:
            return serve_camera(life, self.eye.open, name="head", facts={}, fps=FPS, optics=self.optics)

        kind = ServerKind(name="camera", role="sensor", summary="", config=Nothing, main=main)
        serve(kind, Nothing(), address=self.network.address())


@contextmanager
def station(seed: int = 1, optics: Optics = UNKNOWN, *, has_depth: bool = False) -> Iterator[Station]:
    with VirtualClock(seed, late_ns=1_000_000) as clock:
        yield Station(clock, optics, has_depth=has_depth)


def intrinsics(width: int, height: int) -> Intrinsics:
    return Intrinsics(width=width, height=height, fx=1.0, fy=1.0, cx=0.5, cy=0.0)


def test_what_is_known_of_the_optics_stands_in_what_the_server_states() -> None:
    optics = Optics(intrinsics(2, 1), Mount(parent="world", position_m=(0.0, 0.0, 1.5), quat_wxyz=(1.0, 0.0, 0.0, 0.0)))
    with station(optics=optics) as place:
        place.clock.sleep(2.0)
        assert of_facts(json.loads(place.log.newest(keys.CONFIG_PREFIX + "camera"))) == optics


def test_depth_goes_to_the_bus_in_the_same_write_as_its_picture_with_the_same_time() -> None:
    with station(has_depth=True) as place:
        place.clock.sleep(2.0)
        colour, beside = (place.log.of(key) for key in (KEY, DEPTH))
        assert len(colour) > 30
        assert [(write.value, write.at_s) for write in beside] == [
            (b"depth of " + write.value, write.at_s) for write in colour
        ]
        marks = [[stamp.decode(write.value) for write in place.log.of(keys.stamp(key))] for key in (KEY, DEPTH)]
        assert marks[0] == marks[1]
        facts = json.loads(place.log.newest(keys.CONFIG_PREFIX + "camera"))
        assert (facts["key"], facts["depth"]["key"], facts["depth"]["step_m"]) == (KEY, DEPTH, 0.001)


def test_a_camera_without_depth_states_and_writes_none() -> None:
    with station() as place:
        place.clock.sleep(1.0)
        assert place.log.of(DEPTH) == []
        assert "depth" not in json.loads(place.log.newest(keys.CONFIG_PREFIX + "camera"))


def test_intrinsics_of_pictures_of_another_size_are_refused_at_the_start() -> None:
    told = "intrinsics are for pictures of 640x480, the camera gives 2x1; set width and height"
    with pytest.raises(ThreadFailed, match=told), station(optics=Optics(intrinsics(640, 480))) as place:
        place.clock.sleep(2.0)


def test_a_silent_camera_is_lost_after_a_second_and_back_with_its_first_picture() -> None:
    with station() as place:
        place.clock.sleep(2.0)
        place.eye.is_silent, silent_s = True, place.clock.monotonic_s()
        place.clock.sleep(7.0)
        place.eye.is_silent, back_s = False, place.clock.monotonic_s()
        place.clock.sleep(1.0)
        assert place.told() == [("camera-lost", "is its cap on?"), ("camera-back", "")], "once, though it lasts"
        assert 1.0 - 1 / FPS <= place.at_s("camera-lost")[0] - silent_s <= 1.15
        assert place.at_s("camera-back")[0] - back_s <= 0.15
        (back,) = [event for _, event in place.log.events() if event.name == "camera-back"]
        assert back.detail["silent_s"] == pytest.approx(7.0, abs=0.15)


def test_a_camera_that_is_torn_out_is_looked_for_once_a_second() -> None:
    with station() as place:
        place.clock.sleep(2.0)
        place.eye.is_there = False
        place.clock.sleep(6.0)
        place.eye.is_there = True
        place.clock.sleep(2.0)
    assert [name for name, _ in place.told()] == ["camera-lost", "camera-lost", "camera-back"]
    assert [reason for _, reason in place.told()][:2] == [
        "the camera was torn out; plug it in",
        "no camera; plug it in",
    ]
    pauses = [after - before for before, after in zip(place.eye.tried_s[1:], place.eye.tried_s[2:], strict=False)]
    assert len(pauses) >= 4
    assert all(1.0 <= pause <= 1.12 for pause in pauses)


def test_drops_are_told_when_they_begin_and_three_seconds_after_they_have_ended() -> None:
    with station() as place:
        place.clock.sleep(3.0)
        for _ in range(4):
            place.eye.drops.lost += 2
            place.clock.sleep(1.0)
        place.clock.sleep(6.0)
        names = [name for name, _ in place.told()]
    assert names == ["camera-dropping", "camera-steady"]
    assert 6.0 <= place.at_s("camera-steady")[0] - place.at_s("camera-dropping")[0] <= 8.2
    (steady,) = [event for _, event in place.log.events() if event.name == "camera-steady"]
    assert steady.detail["dropped"] == 8


@pytest.mark.parametrize("seed", SEEDS)
def test_whatever_happens_no_old_picture_is_written_and_all_is_well_again_when_it_is_over(seed: int) -> None:
    rng = random.Random(seed)
    frozen: list[tuple[float, float, int]] = []  # from, to [s], and how many faults in a row
    with station(seed) as place:
        for _ in range(12):
            place.clock.sleep(rng.uniform(0.1, 1.5))
            seconds = rng.choice((0.03, 0.2, 1.0))
            now_s = place.clock.monotonic_s()
            what = rng.choice(("silent", "torn", "freeze", "line", "cut", "bus", "restart"))
            if what in ("silent", "torn"):
                name, value = ("is_silent", True) if what == "silent" else ("is_there", False)
                setattr(place.eye, name, value)
                place.clock.sleep(seconds * 2)
                setattr(place.eye, name, not value)
                continue
            begun_s, end_s, faults = frozen.pop() if frozen and frozen[-1][1] >= now_s else (now_s, now_s, 0)
            frozen.append((begun_s, max(end_s, now_s + seconds + OLD_S), faults + 1))
            if what == "freeze":
                place.clock.freeze(place.process, seconds)
            elif what == "line":
                place.network.freeze(place.process, seconds)
            elif what == "cut":
                place.network.cut(place.process)
            elif what == "bus":
                place.network.freeze_server(seconds)
            else:
                place.network.restart_server(seconds)
        place.clock.sleep(5.0)
        written = place.log.of(KEY)
        old = [write.at_s for write, age_s in zip(written, place.ages_s(), strict=True) if age_s > OLD_S]
        for begin_s, end_s, faults in frozen:
            of_this = [at_s for at_s in old if begin_s <= at_s <= end_s]
            assert len(of_this) <= 2 * faults, f"seed {seed}: only what was on its way comes late, at {of_this}"
            old = [at_s for at_s in old if at_s not in of_this]
        assert old == [], f"seed {seed}"
        numbers = [int(write.value) for write in written]
        assert numbers == sorted(set(numbers)), f"seed {seed}: each once, in their order"
        after_s = place.clock.monotonic_s() - 2.0
        assert sum(write.at_s > after_s for write in written) >= 0.9 * 2.0 * FPS, f"seed {seed}: it goes on"
