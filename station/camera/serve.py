"""The loop that all cameras share: read the newest picture, publish, tell.

A picture is one atomic write of a whole JPEG file and its stamp, with the time of capture in it; of a camera that gives
depth, that is in the same write, of the same moment. Nothing is queued: as
long as the bus owes the answer to a picture no other is written, and the newest one goes when it has answered. What is
dropped, and where, is counted and stands in the server's health; that it begins and ends are the events
``camera-dropping`` and ``camera-steady``. A camera that gives nothing, or is torn out, is ``camera-lost``; it is looked
for once a second, and ``camera-back`` when it gives pictures again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from station.bus import keys
from station.camera.source import Camera, CameraError, Drops, Picture
from station.life.server import Life
from station.optics import Optics

_AGAIN_S = 1.0
_LOOK_S = 0.1  # longest wait for a picture, so that a wish to stop is heard
_SILENT_S = 1.0
_PERIODS = 5  # without a picture are silence too, for a slow camera
_STEADY_S = 3.0
_UNKNOWN = Optics()


def serve_camera(
    life: Life,
    open_camera: Callable[[], Camera],
    *,
    name: str,
    facts: Mapping[str, Any],
    fps: float | None,
    optics: Optics = _UNKNOWN,
) -> int:
    """Open a camera and publish its pictures until the server is asked to stop; return the exit code.

    Args:
        life: The server's.
        open_camera: Opens the camera; called again after it was lost.
        name: Of the camera, in the key of its pictures.
        facts: What a manifest says of the server, beside what the camera itself says.
        fps: Pictures per second that are wanted [Hz]; None where the camera decides.
        optics: What is known of the camera's optics here; goes before what the camera itself says.

    Raises:
        CameraError: the camera cannot be opened at the start, or the optics are for pictures of another size.
    """
    key = keys.camera_image(name)
    head = {"server": life.name, "role": "sensor", "camera": name, "key": key, "fps_wanted": fps, **facts}
    camera_loop = _CameraLoop(life, open_camera, name, head, optics)
    try:
        if not life.ready():
            return 0
        camera_loop.begin()
        while not life.stopping:
            camera_loop.step()
    finally:
        camera_loop.close()
    return 0


class _CameraLoop:
    """Between a camera and the bus."""

    def __init__(
        self, life: Life, open_camera: Callable[[], Camera], name: str, head: Mapping[str, Any], optics: Optics
    ) -> None:
        self._life, self._open, self._head, self._optics = life, open_camera, head, optics
        self._key, self._depth_key = keys.camera_image(name), keys.camera_depth(name)
        self._clock = life.clock
        self._camera: Camera | None = None
        self._silence_s, self._look_s = _SILENT_S, 0.0
        self._is_live, self._reason = True, ""  # until the contrary shows
        self._past = Drops()  # of cameras before this one
        self._unsent = 0
        self._published, self._bytes = 0, 0
        self._capture_ns: int | None = None
        self._picture_s = self._clock.monotonic_s()  # when the newest one came
        self._meter = _Meter(life)
        self._facts: dict[str, Any] = {}
        self._capture(open_camera())

    def begin(self) -> None:
        """Count time from now on: what was taken before the server was active is old."""
        self._picture_s = self._clock.monotonic_s()
        self._meter.begin(self._picture_s, self._published, self._drops)

    def step(self) -> None:
        """Wait for a picture for a moment and take it to the bus."""
        picture = self._read()
        now_s = self._clock.monotonic_s()
        if picture is not None:
            self._welcome(now_s)
            self._publish(picture)
        elif self._camera is not None and now_s - self._picture_s > self._silence_s and now_s >= self._look_s:
            self._look_s = now_s + _AGAIN_S
            self._lose(self._camera.why_silent() or "it gives no pictures", now_s)
        age_ms = None if self._capture_ns is None else (self._clock.monotonic_ns() - self._capture_ns) * 1e-6
        self._meter.update(now_s, self._published, self._bytes, self._drops, self._unsent, age_ms)

    def close(self) -> None:
        """Let go of the camera."""
        self._release()

    @property
    def _drops(self) -> Drops:
        return self._past + self._camera.drops if self._camera is not None else self._past

    def _read(self) -> Picture | None:
        if self._camera is None:
            self._reopen()
        if self._camera is None:
            self._clock.wait(self._life.stop_event, _LOOK_S)
            return None
        try:
            return self._camera.read(_LOOK_S)
        except CameraError as error:
            self._release()
            now_s = self._clock.monotonic_s()
            self._look_s = now_s + _AGAIN_S
            self._lose(str(error), now_s)
            return None

    def _reopen(self) -> None:
        now_s = self._clock.monotonic_s()
        if now_s < self._look_s:
            return
        self._look_s = now_s + _AGAIN_S
        try:
            self._capture(self._open())
        except CameraError as error:
            self._lose(str(error), now_s)

    def _capture(self, camera: Camera) -> None:
        self._camera, facts = camera, {**camera.facts(), **self._optics.facts()}
        _expect_size(self._optics, facts)
        if depth := facts.get("depth"):
            facts["depth"] = {"key": self._depth_key, **depth}
        if facts != self._facts:
            self._facts = facts
            self._life.configured({**self._head, **facts})
        if facts.get("fps"):
            self._silence_s = max(_SILENT_S, _PERIODS / facts["fps"])

    def _publish(self, picture: Picture) -> None:
        bus = self._life.bus
        is_behind = bus.is_late and not bus.catch_up()
        values = {self._key: picture.jpeg, **({self._depth_key: picture.depth} if picture.depth else {})}
        if is_behind or not bus.publish(values, capture_ns=picture.capture_ns):
            self._unsent += 1
            return
        self._published += 1
        if self._camera is not None and self._facts.get("width") is None:
            self._capture(self._camera)  # a stream shows its size with its first picture
        self._bytes += len(picture.jpeg) + len(picture.depth)
        self._capture_ns = picture.capture_ns

    def _welcome(self, now_s: float) -> None:
        if not self._is_live:
            self._is_live, self._reason = True, ""
            silent_s = round(now_s - self._picture_s, 3)
            self._life.event("camera-back", key=self._key, silent_s=silent_s, device=self._facts.get("device"))
        self._picture_s = now_s
        self._life.report(camera="live", reason="")

    def _lose(self, reason: str, now_s: float) -> None:
        if not self._is_live and reason == self._reason:
            return
        self._is_live, self._reason = False, reason
        silent_s = round(now_s - self._picture_s, 3)
        self._life.event("camera-lost", severity="warning", key=self._key, reason=reason, silent_s=silent_s)
        self._life.report(camera="lost", reason=reason)

    def _release(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            self._past += camera.drops
            camera.close()


def _expect_size(optics: Optics, facts: Mapping[str, Any]) -> None:
    """Refuse intrinsics of pictures of another size; that of a stream is not known before its first picture."""
    inner, width, height = optics.intrinsics, facts.get("width"), facts.get("height")
    if inner is not None and None not in (width, height) and (inner.width, inner.height) != (width, height):
        raise CameraError(
            f"intrinsics are for pictures of {inner.width}x{inner.height}, the camera gives {width}x{height}; "
            "set width and height of the camera, or scale the intrinsics"
        )


class _Meter:
    """Once a second: how many pictures went to the bus, how many did not, and when that begins and ends."""

    def __init__(self, life: Life) -> None:
        self._life = life
        self._since_s, self._published, self._bytes, self._dropped = 0.0, 0, 0, 0
        self._dropping_since: tuple[float, int] | None = None
        self._dropped_s = 0.0

    def begin(self, now_s: float, published: int, drops: Drops) -> None:
        """Start counting."""
        self._since_s, self._published, self._dropped = now_s, published, drops.total

    def update(
        self, now_s: float, published: int, size: int, drops: Drops, unsent: int, age_ms: float | None
    ) -> None:  # fmt: skip
        """Report when a second is over."""
        elapsed_s = now_s - self._since_s
        if elapsed_s < 1.0:
            return
        count, dropped = published - self._published, drops.total + unsent
        self._life.report(
            rate_hz=round(count / elapsed_s, 2), pictures=published, dropped=dropped, lost=drops.lost,
            skipped=drops.skipped, torn=drops.torn, unsent=unsent, age_ms=None if age_ms is None else round(age_ms, 1),
            kilobytes=round((size - self._bytes) / count / 1e3, 1) if count else None,
        )  # fmt: skip
        self._publish(now_s, dropped, drops, unsent)
        self._since_s, self._published, self._bytes, self._dropped = now_s, published, size, dropped

    def _publish(self, now_s: float, dropped: int, drops: Drops, unsent: int) -> None:
        new = dropped - self._dropped
        if new:
            self._dropped_s = now_s
            if self._dropping_since is None:
                self._dropping_since = (self._since_s, self._dropped)
                self._life.event("camera-dropping", severity="warning", dropped=new, lost=drops.lost,
                                 skipped=drops.skipped, torn=drops.torn, unsent=unsent)  # fmt: skip
        elif self._dropping_since is not None and now_s - self._dropped_s >= _STEADY_S:
            since_s, before = self._dropping_since
            self._dropping_since = None
            self._life.event("camera-steady", dropped=dropped - before, for_s=round(self._dropped_s - since_s, 1))
