"""A fake page: signs in with this user's secrets, answers for its clock, and sends frames on time."""

from __future__ import annotations

import contextlib
import json
import logging
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from adapters.devices.fakes.pico import script as scripts
from adapters.devices.fakes.pico.play import Wearer
from adapters.devices.webxr.body import JOINTS as BODY
from adapters.devices.webxr.body import KNUCKLES, PLACES
from adapters.devices.webxr.controls import SENT, TOUCH_HOLD
from adapters.devices.webxr.frame import FRAME, PARTS, packed
from adapters.retarget import frames
from adapters.retarget.human import SIDES
from station import rotations
from station.bus.joints import SMPL_24
from station.operator.sample import Body, OperatorSample
from station.protocols import Floats
from station.stop_signals import set_on_signals
from station.web.doorkeeper import Cookies
from station.web.keyring import Keyring

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

log = logging.getLogger(__name__)

_AGAIN_S = 0.1
_SLICE_S = 0.1
_CLOSED_WITHIN_S = 5.0
_PALM_M, _KNUCKLE_M = 0.08, 0.03  # wrist to knuckles, and from their middle to the index finger's
_CLOCK_AHEAD_S = 0.125  # a page's clock begins with the page


class FakePage:
    """It, in a thread of its own; a context manager.

    Args:
        script: File of its script.
        url: Of the page.
        start_s: Time of the script to begin at [s].
        authority: Of the page's certificate; None for the system's.

    Raises:
        BadFile: the script cannot be read; the message names file and field.
    """

    def __init__(self, script: Path, url: str, start_s: float = 0.0, authority: Path | None = None) -> None:
        self._wearer = Wearer(scripts.load(script, "webxr"))
        self._url, self._start_s, self._authority = url, start_s, authority
        self._stop, self._go = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="fake-page", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Let the script begin."""
        self._go.set()

    def __enter__(self) -> FakePage:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._go.set()
        self._thread.join(_CLOSED_WITHIN_S)

    def _run(self) -> None:
        self._go.wait()
        play(
            self._wearer, lambda: opened(self._url, self._authority), self._stop.is_set, start_s=self._start_s,
            on_trouble=lambda why: log.warning("the fake page is not open: %s; it tries again", why),
        )  # fmt: skip


def play(
    wearer: Wearer,
    open_page: Callable[[], contextlib.AbstractContextManager[ClientConnection]],
    stopping: Callable[[], bool],
    *,
    start_s: float = 0.0,
    on_trouble: Callable[[str], object] = lambda why: None,
) -> None:
    """Send the frames of a script on time until asked to stop, by a page that is opened again when it is gone.

    Args:
        wearer: Makes them.
        open_page: Opens the page's socket.
        stopping: Whether to stop; looked at ten times a second at least.
        start_s: Time of the script to begin at [s].
        on_trouble: Called with why the page could not be opened, or is gone; once for each reason.
    """
    from websockets.exceptions import WebSocketException

    began_s, told = time.monotonic() - start_s, ""
    while not stopping():
        if wearer.fault(time.monotonic() - began_s, "crash"):
            time.sleep(_SLICE_S)
            continue
        try:
            with open_page() as socket:
                _send(wearer, socket, stopping, began_s)
        except (OSError, WebSocketException) as error:
            why = str(error) or type(error).__name__
            if why != told:
                told = why
                on_trouble(why)
            time.sleep(_AGAIN_S)


@contextlib.contextmanager
def opened(url: str, authority: Path | None = None) -> Iterator[ClientConnection]:
    """Open the socket of a page that drives, as this user's; it answers for its clock by itself."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect
    from websockets.typing import Origin

    port, is_secure = int(url.rstrip("/").rpartition(":")[2]), url.startswith("https:")
    keyring = Keyring()
    cookie = Cookies(keyring, port, is_secure=is_secure).header(keyring.token("operator")).partition(";")[0]
    context = ssl.create_default_context(cafile=authority) if is_secure else None
    where = f"ws{url.removeprefix('http')}ws/pose"
    given = {"Cookie": cookie}
    with connect(
        where, origin=Origin(url.rstrip("/")), additional_headers=given, compression=None, ssl=context
    ) as socket:

        def answer() -> None:
            with contextlib.suppress(ConnectionClosed):
                for message in socket:
                    said = json.loads(message)
                    if said["t"] == "ping":
                        socket.send(json.dumps({"t": "pong", "id": said["id"], "at_ms": page_ms()}))

        answering = threading.Thread(target=answer, name="fake-page-clock", daemon=True)
        answering.start()
        yield socket
    answering.join(_CLOSED_WITHIN_S)


def page_ms() -> float:
    """Return the time on a fake page's clock [ms]."""
    return (time.monotonic() - _CLOCK_AHEAD_S) * 1e3


def _send(wearer: Wearer, socket: ClientConnection, stopping: Callable[[], bool], began_s: float) -> None:
    number = wearer.number(time.monotonic() - began_s)
    while not stopping():
        due_s = wearer.time_s(number)
        while (left_s := began_s + due_s - time.monotonic()) > 0.0:
            time.sleep(min(left_s, _SLICE_S))
            if stopping():
                return
        if wearer.fault(due_s, "crash"):
            return
        if (given := wearer.sample(number)) is not None:
            stamped_s, sample = given
            data = frame_of(sample, (began_s + stamped_s - _CLOCK_AHEAD_S) * 1e3, page_ms())
            kind = wearer.spoilt(number)
            socket.send(data[:100] if kind == "torn" else poisoned(data) if kind == "poison" else data)
        number = wearer.next_number(number, time.monotonic() - began_s)


def frame_of(sample: OperatorSample, taken_ms: float, sent_ms: float) -> bytes:
    """Return a sample as a page sends it.

    Args:
        sample: In our axes.
        taken_ms, sent_ms: When it was taken and leaves, on the page's clock [ms].
    """
    values: dict[str, Any] = {"taken_ms": taken_ms, "sent_ms": sent_ms}
    is_phone = TOUCH_HOLD in sample.controls
    is_worn = not is_phone or sample.head is None  # a phone that is itself the hand has no head
    for name in ("head", "left", "right") if is_worn else ():
        if (pose := getattr(sample, name)) is not None:
            values[name] = _rows(np.concatenate([pose.position, pose.quat_wxyz])[np.newaxis])[0]
    parts = sum(PARTS[name] for name in values if name in PARTS)
    for side, hand in sample.hands.items():
        values[f"hand_{side}"] = _rows(hand[1:])  # a page has no palm
        parts |= PARTS[f"hand_{side}"]
    if sample.body is not None:
        values["body"] = seen_by_a_browser(sample.body)
        parts |= PARTS["body"]
    if sample.controls:
        signs = [-1.0 if name.endswith("stick_y") else 1.0 for name in SENT]
        sent = [sign * sample.controls.get(name, 0.0) for name, sign in zip(SENT, signs, strict=True)]
        values["controls"] = [*sent, sample.controls.get(TOUCH_HOLD, 0.0)]
        parts |= PARTS["touch"] * is_phone
        sides = [side for side in ("left", "right") if is_phone or getattr(sample, side) is not None]
        parts |= sum(PARTS[f"controls_{side}"] for side in sides)
    return packed(parts=parts, **values)


def seen_by_a_browser(body: Body) -> Floats:
    """Return where a browser has the joints of a body, shape (21, 3), in WebXR's axes [m]."""
    place = dict(zip(SMPL_24, body.positions, strict=True))
    found = {"head": place["head"], "neck": place["neck"], "spine-middle": place["spine2"]}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        found |= {f"{side}-{theirs}": place[f"{side}_{'foot' if ours == 'ball' else ours}"]
                  for ours, theirs in PLACES.items()}  # fmt: skip
        turn, wrist = body.quats_wxyz[SMPL_24.index(f"{side}_wrist")], place[f"{side}_wrist"]
        for name, ahead_m in zip(KNUCKLES, (_KNUCKLE_M, -_KNUCKLE_M), strict=True):
            found[f"{side}-{name}"] = wrist + rotations.rotate(turn, [ahead_m, sign * _PALM_M, 0.0])
    return frames.positions_from_flu(np.array([found[name] for name in BODY]))


def poisoned(data: bytes) -> bytes:
    """Return a frame whose head is nowhere."""
    frame = np.frombuffer(data, FRAME).copy()
    frame["head"] = np.nan
    return frame.tobytes()


def _rows(rows: Floats) -> Floats:
    """Return poses (n, 7) of our axes, x y z qw qx qy qz, as WebXR has them: x y z qx qy qz qw."""
    quats = frames.xyzw(frames.quats_from_flu(rows[:, 3:]))
    return np.concatenate([frames.positions_from_flu(rows[:, :3]), quats], axis=-1)


def play_for_person(file: Path, port: int) -> None:
    """Play a script in a page of the server on a port of this machine, until Ctrl-C; raises as `FakePage`."""
    stop = threading.Event()
    set_on_signals(stop)
    wearer = Wearer(scripts.load(file, "webxr"))
    click.echo(f"a fake page opens http://127.0.0.1:{port}/; Ctrl-C takes it away", err=True)
    play(
        wearer, lambda: opened(f"http://127.0.0.1:{port}/"), stop.is_set,
        on_trouble=lambda why: click.echo(f"not open yet: {why}; does a webxr server run? It tries again", err=True),
    )  # fmt: skip
