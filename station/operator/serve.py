"""The loop that all device servers share: read, judge, publish, tell.

A tick with a new sample is one atomic write of the sample and the status, with the device's time of capture in the
stamps; any other tick writes the status alone (and what stock readers expect at every tick). Changes of state are the
events ``operator-live``, ``operator-stale`` and ``operator-lost``, the last one with what is known of the reason. A
device that is torn out is looked for again, once a second, until it is there.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from station.life.events import Severity
from station.life.loop import Rate, real_time
from station.life.server import Life
from station.operator import sample as readings
from station.operator.device import Device, DeviceError, Source
from station.operator.sample import OperatorSample, Part, State, Status

_AGAIN_S = 1.0
_SEVERITY: dict[State, Severity] = {"live": "info", "stale": "warning", "lost": "warning"}


def serve_device(
    life: Life,
    source: Source,
    *,
    rate_hz: float,
    config: Mapping[str, Any],
    on_active: Callable[[], Mapping[str, Any]] | None = None,
    punctual: Callable[[], str] = real_time,
) -> int:
    """Open a device and publish what it gives until the server is asked to stop; return the exit code.

    Args:
        life: The server's; its name is the device's on the bus.
        source: Opens the device, at once and again after it was lost.
        rate_hz: Looks per second [Hz].
        config: The server's configuration in plain values, for the manifest.
        on_active: Called once when the server is active; what it returns joins the stated configuration.
        punctual: Makes this process as punctual as it may be; says what was obtained.

    Raises:
        DeviceError: the device cannot be opened at the start.
    """
    device_loop = _DeviceLoop(life, source)
    beside = contextlib.ExitStack()
    try:
        facts = {"server": life.name, "role": "sensor", "rate_hz": rate_hz, "device": device_loop.facts(),
                 "config": dict(config)}  # fmt: skip
        life.configured(facts)
        if not life.ready():
            return 0
        if on_active is not None:
            life.configured(facts | dict(on_active()))
        if source.beside is not None:
            beside.enter_context(source.beside(life.bus.address, life.name))
        life.report(scheduling=punctual())
        _run(life, device_loop, rate_hz, source.numbers or dict)
    finally:
        device_loop.close()
        beside.close()
    return 0


def _run(life: Life, device_loop: _DeviceLoop, rate_hz: float, numbers: Callable[[], Mapping[str, Any]]) -> None:
    rate, ticks, counted = Rate(rate_hz, life.clock), 0, 0
    window = max(2, round(rate_hz))
    while not life.stopping:
        rate.wait()
        device_loop.tick(life.clock.monotonic_s())
        ticks += 1
        if ticks % window == 0:  # once a second
            samples_hz = (device_loop.new - counted) * rate_hz / window
            life.report(**msgspec.structs.asdict(rate.stats()), samples_hz=samples_hz, **numbers())
            counted = device_loop.new


class _DeviceLoop:
    """Between a device and the bus."""

    def __init__(self, life: Life, source: Source) -> None:
        self._life, self._open, self._also = life, source.open, source.also
        self._freshness = Freshness()
        self._state: State = "lost"
        self._reason, self._told = "", ""
        self._parts: tuple[Part, ...] = ()
        self._newest = OperatorSample()
        self._look_s = life.clock.monotonic_s() + _AGAIN_S  # a device that is there needs a moment to say so
        self._device: Device | None = source.open()

    @property
    def new(self) -> int:
        """Number of samples so far."""
        return self._freshness.new

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of the device."""
        return self._device.facts() if self._device is not None else {}

    def tick(self, now_s: float) -> None:
        """Publish what the device gives at a monotonic time [s]."""
        sample = self._read(now_s)
        silence_s = self._freshness.silence_s(now_s)
        is_new = self._freshness.step(now_s, sample)
        values: dict[str, bytes] = {}
        if is_new and sample is not None:
            self._newest, self._parts = sample, readings.parts(sample)
            values = readings.encode(self._life.name, sample)
        self._judge(now_s, silence_s)
        self._write(values)

    def close(self) -> None:
        """Let go of the device, and say that there is nothing more to come."""
        self._release()
        self._state, self._reason = "lost", "the device server has ended"
        self._write({})

    def _read(self, now_s: float) -> OperatorSample | None:
        if self._device is None:
            self._reopen(now_s)
            return None
        try:
            return self._device.read()
        except DeviceError as error:
            self._release()
            self._freshness.lose()
            self._reason, self._look_s = str(error), now_s + _AGAIN_S
            return None

    def _reopen(self, now_s: float) -> None:
        if now_s < self._look_s:
            return
        self._look_s = now_s + _AGAIN_S
        try:
            self._device = self._open()
        except DeviceError as error:
            self._reason = str(error)

    def _judge(self, now_s: float, silence_s: float) -> None:
        """Publish changes of state; and why the device is lost, when that is known or changes."""
        state = self._freshness.state
        if state == "lost" and self._device is not None and now_s >= self._look_s:
            self._look_s = now_s + _AGAIN_S
            self._reason = self._device.why_silent()
        if state == "stale":
            self._reason = "no new sample for a moment"
        elif state == "live":
            self._reason = ""
        if state != self._state or self._reason != self._told:
            if state != "lost":
                self._look_s = 0.0  # ask why as soon as it is lost
            self._publish_state(state, silence_s)

    def _publish_state(self, state: State, silence_s: float) -> None:
        detail: dict[str, Any] = {"device": self._life.name, "new": self._freshness.new}
        if self._reason:
            detail["reason"] = self._reason
        if state != "live" and math.isfinite(silence_s):
            detail["silent_s"] = round(silence_s, 3)
        self._state, self._told = state, self._reason
        self._life.event(f"operator-{state}", severity=_SEVERITY[state], **detail)
        self._life.report(operator=state, reason=self._reason)

    def _write(self, values: dict[str, bytes]) -> None:
        freshness = self._freshness
        status = Status(
            state=self._state, reason=self._reason, capture_ns=freshness.capture_ns, new=freshness.new,
            repeated=freshness.repeated, parts=self._parts,
        )  # fmt: skip
        if self._also is not None:
            is_lost = self._state == "lost"
            values |= self._also(OperatorSample(capture_ns=freshness.capture_ns) if is_lost else self._newest)
        values |= readings.encode_status(self._life.name, status)
        self._life.bus.publish(values, capture_ns=freshness.capture_ns)

    def _release(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()


class Freshness:
    """Judges by new samples, that is by changes of the device's own time stamp, on given monotonic times.

    A device that tells no time is taken to have a new sample whenever it gives a reading.

    Samples that begin to flow again must flow for `settle_s` before the device counts as live, so that one which sends
    too slowly is stale, and not live and stale in turns.

    Args:
        stale_after_s: Time without a new sample after which the device is stale [s].
        lost_after_s: And after which it is lost [s].
        settle_s: Time for which new samples must have come, none later than `stale_after_s`, to be live again [s].

    Attributes:
        state: The present state; ``lost`` before the first sample.
        new: Number of new samples so far.
        repeated: Number of steps without one.
        capture_ns: Device's time of the newest sample [ns]; None before it, or where the device tells no time.
    """

    def __init__(self, *, stale_after_s: float = 0.1, lost_after_s: float = 1.0, settle_s: float = 0.1) -> None:
        self.state: State = "lost"
        self.new = 0
        self.repeated = 0
        self.capture_ns: int | None = None
        self._stale_after_s, self._lost_after_s, self._settle_s = stale_after_s, lost_after_s, settle_s
        self._newest_s = -math.inf
        self._flowing_since_s = math.inf

    def silence_s(self, now_s: float) -> float:
        """Return the time since the newest sample [s]; infinite before the first."""
        return now_s - self._newest_s

    def step(self, now_s: float, sample: OperatorSample | None) -> bool:
        """Record what the device gave at a monotonic time [s]; return whether that is a new sample."""
        is_new = sample is not None and (sample.capture_ns is None or sample.capture_ns != self.capture_ns)
        silence_s = self.silence_s(now_s)
        self._judge(silence_s)  # before the sample counts: a gap between two steps is a gap
        if is_new and sample is not None:
            self.new += 1
            self.capture_ns = sample.capture_ns
            self._newest_s = now_s
            if silence_s > self._stale_after_s:
                self._flowing_since_s = now_s
            self._judge(0.0)
        else:
            self.repeated += 1
        return is_new

    def _judge(self, silence_s: float) -> None:
        if silence_s > self._lost_after_s:
            self.state = "lost"
        elif silence_s > self._stale_after_s:
            if self.state == "live":
                self.state = "stale"
        elif self._newest_s - self._flowing_since_s >= self._settle_s:
            self.state = "live"

    def lose(self) -> None:
        """Be lost at once: the device itself says that it is gone."""
        self.state = "lost"
        self._newest_s = -math.inf
