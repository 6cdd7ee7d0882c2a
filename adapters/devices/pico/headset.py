"""The headset as a `station.operator.device.Device`.

What `xrobotoolkit_sdk` does to a process, and what is done about it here:

- Nothing says that it is not connected: every getter answers zeros, or for ever what came last. Only the headset's time
  stamp tells; a sample is new when it has moved. A pose of zeros is none.
- What is tracked no more keeps its last values as well. A body counts for as long as its own stamp moves; controllers
  and hands, which have none, until they have stood still to the last bit for half a second, which none that is held or
  seen ever does. The buttons of such a controller are no buttons: a dead-man button must not stay pressed.
- `init` twice, or leaving without `close`, aborts the process; `close` without `init` ends it. So there is one headset
  per process, and it is closed at exit. (A server is asked to stop by SIGTERM; a program of your own must see to that.)
- `close` while it connects hangs in four of ten cases, and holds the interpreter's lock meanwhile. So it is left to
  connect first; and if it hangs all the same, the process is ended from outside the interpreter.
- A service that dies and is back within half a second goes unnoticed: the library never listens to the new one. So a
  headset that has been silent for five seconds is given up, and whoever reads it opens another.
- A frame that it cannot parse aborts the process. Nobody can prevent that: it is why the library lives in a server of
  its own, which is started again.
- It writes to the standard output: see `quiet`. It takes the service's address from a file in the current folder: one
  is written into a private folder for the moment.
- Velocities of the body are of another meaning and frame than named; they are not read.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import importlib
import math
import os
import socket
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from adapters.devices.pico.controls import CONTROLS
from adapters.retarget import frames
from station import rotations
from station.bus.joints import SMPL_24
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.operator.sample import Body, OperatorSample, Pose, Side
from station.protocols import Floats

LIBRARY = "xrobotoolkit-sdk"
DEFAULT_PORT = 60061

_BODY_GONE_NS = 100_000_000
_STILL_NS = 500_000_000
_TRIES = 3  # a frame that comes while one is being read; two in a row within microseconds do not happen
_LOOK_S = 0.1
_CONNECTING_S = 1.0  # two beats of the library
_NAP_S = 0.1
_HANGS_S = 5.0
_STDERR = 2
_SIDES: tuple[Side, ...] = ("left", "right")

_in_use = False

_STDOUT = 1


class Headset:
    """Connects to the PC service in the background; without one it waits.

    Args:
        address: Where the PC service is.
        port: Its TCP port.
        patience_s: Silence after which one that did send is given up [s].
        clock: Of the process.

    Raises:
        DeviceError: the library is not installed, or this process has a headset already.
    """

    def __init__(
        self, address: str = "127.0.0.1", port: int = DEFAULT_PORT, *, patience_s: float = 5.0, clock: Clock = SYSTEM
    ) -> None:
        self._clock = clock
        self._sdk = _import_sdk()
        _reserve()
        self._address, self._port = address, port
        self._patience_s = patience_s
        self._next_look_s, self._looks = math.inf, 0  # whether there is a service, though nothing comes
        self._body = _Newest()
        self._controllers = {side: _Newest() for side in _SIDES}
        self._hands = {side: _Newest() for side in _SIDES}
        self._quiet = QuietStdout()
        self._stamp_ns = self._sdk.get_time_stamp_ns()  # not 0 where an earlier one has left its last values behind
        with _folder_that_names(address, port):
            self._sdk.init()
        self._opened_s = self._clock.monotonic_s()
        atexit.register(self.close)
        self._is_open = True

    def read(self) -> OperatorSample | None:
        """Return the newest sample, or None when the headset's time stamp has not moved since the last call.

        Raises:
            DeviceError: it did send, and has been silent for long.
        """
        stamp_ns, now_s = self._sdk.get_time_stamp_ns(), self._clock.monotonic_s()
        if stamp_ns in (0, self._stamp_ns):
            self._give_up_at(now_s)
            return None
        self._next_look_s, self._looks = now_s + self._patience_s, 0
        for _ in range(_TRIES):
            reading, before_ns = self._reading(stamp_ns), stamp_ns
            stamp_ns = self._sdk.get_time_stamp_ns()
            if stamp_ns == before_ns:  # else a frame came in between, and this may be half of it
                break
        self._stamp_ns = before_ns
        return reading

    def why_silent(self) -> str:
        """Return what is missing: the service, the headset, or its data."""
        where, what = f"{self._address}:{self._port}", "no headset any more" if self._stamp_ns else "no headset yet"
        if not self._has_service():
            return f"{what}: no PC service answers at {where}; start XRoboToolkit's PC Service there"
        if self._stamp_ns:
            return "the headset sends nothing: it is taken off or asleep, its app is closed, or the network is gone"
        return (
            f"no headset yet: the PC service at {where} has none; in the headset's XRoboToolkit app enter this "
            "computer's address, and switch on Head, Controller and Send"
        )

    def facts(self) -> dict[str, Any]:
        """Return the library with its version, and where the service is."""
        return {"library": f"{LIBRARY} {metadata.version(LIBRARY)}", "service": f"{self._address}:{self._port}"}

    def close(self) -> None:
        """Disconnect, within two seconds; a second call does nothing."""
        if not self._is_open:
            return
        self._is_open = False
        early_s = self._opened_s + _CONNECTING_S - self._clock.monotonic_s()
        for _ in range(math.ceil(max(early_s, 0.0) / _NAP_S)):  # a machine that stands still takes one nap away
            self._clock.sleep(_NAP_S)
        faulthandler.dump_traceback_later(_HANGS_S, exit=True, file=_STDERR)
        self._sdk.close()
        faulthandler.cancel_dump_traceback_later()
        self._quiet.restore()
        atexit.unregister(self.close)
        _give_back()

    def _give_up_at(self, now_s: float) -> None:
        """Give up where a service has been there for a while; where there is none, the library waits for one well.

        Raises:
            DeviceError: it is time to open another.
        """
        if now_s < self._next_look_s:
            return
        self._next_look_s = now_s + 2 * _CONNECTING_S
        self._looks = self._looks + 1 if self._has_service() else 0
        if self._looks > 1:
            raise DeviceError(self.why_silent())

    def _has_service(self) -> bool:
        try:
            socket.create_connection((self._address, self._port), timeout=_LOOK_S).close()
        except OSError:
            return False
        return True

    def _reading(self, stamp_ns: int) -> OperatorSample:
        sdk = self._sdk
        controllers = {side: self._controller(side, stamp_ns) for side in _SIDES}
        return OperatorSample(
            capture_ns=stamp_ns,
            controls=self._controls([side for side, pose in controllers.items() if pose is not None]),
            head=_pose(sdk.get_headset_pose()),
            left=controllers["left"],
            right=controllers["right"],
            body=self._whole_body(stamp_ns),
            hands={side: hand for side in _SIDES if (hand := self._hand(side, stamp_ns)) is not None},
        )

    def _controller(self, side: Side, stamp_ns: int) -> Pose | None:
        values = getattr(self._sdk, f"get_{side}_controller_pose")()
        if self._controllers[side].age_ns(values, stamp_ns) > _STILL_NS:
            return None
        return _pose(values)

    def _controls(self, sides: Sequence[Side]) -> dict[str, float]:
        found = {}
        for name, control in CONTROLS.items():
            if control.side in sides:
                value = getattr(self._sdk, control.call)()
                found[name] = float(value if control.index is None else value[control.index])
        return found

    def _whole_body(self, stamp_ns: int) -> Body | None:
        sdk = self._sdk
        if not sdk.is_body_data_available():
            return None
        if self._body.age_ns(sdk.get_body_timestamp_ns(), stamp_ns) > _BODY_GONE_NS:
            return None
        rows = _converted(sdk.get_body_joints_pose(), len(SMPL_24))
        return None if rows is None else Body(rows[:, :3], rows[:, 3:])

    def _hand(self, side: Side, stamp_ns: int) -> Floats | None:
        if not getattr(self._sdk, f"get_{side}_hand_is_active")():
            return None
        values = getattr(self._sdk, f"get_{side}_hand_tracking_state")()
        if self._hands[side].age_ns(values, stamp_ns) > _STILL_NS:
            return None
        return _converted(values, len(values))


class _Newest:
    """A value that the library keeps for ever, and since when it has been so."""

    def __init__(self) -> None:
        self._value: Any = None
        self._since_ns = 0

    def age_ns(self, value: Any, stamp_ns: int) -> int:
        """Return how long a value has not changed, on the headset's clock [ns]."""
        if value != self._value or stamp_ns < self._since_ns:
            self._value, self._since_ns = value, stamp_ns
        return stamp_ns - self._since_ns


def _pose(values: Sequence[float]) -> Pose | None:
    rows = _converted([values], 1)
    return None if rows is None else Pose(rows[0, :3], rows[0, 3:])


def _converted(values: Sequence[Sequence[float]], count: int) -> Floats | None:
    """Return poses in our frame, shape (count, 7): x y z [m] qw qx qy qz; None where one of them is none."""
    rows = np.array(values, dtype=np.float64)
    if rows.shape != (count, 7) or not np.isfinite(rows).all():
        return None
    lengths = np.linalg.norm(rows[:, 3:], axis=-1)
    if (lengths < 0.5).any():  # zeros: no data
        return None
    quats = frames.quats_to_flu(rotations.normalized(frames.wxyz(rows[:, 3:])))
    return np.concatenate([frames.positions_to_flu(rows[:, :3]), quats], axis=-1)


def _import_sdk() -> Any:
    try:
        return importlib.import_module("xrobotoolkit_sdk")
    except ImportError as error:
        raise DeviceError(
            f"a Pico headset needs {LIBRARY} ({error}); pip install 'teleop-station[pico]', on Linux with glibc 2.34 "
            "(Ubuntu 22.04, Debian 12) or newer"
        ) from error


def _reserve() -> None:
    global _in_use  # noqa: PLW0603  # the library itself is one per process
    if _in_use:
        raise DeviceError("this process has a Pico headset already; the library allows one, so close that first")
    _in_use = True


def _give_back() -> None:
    global _in_use  # noqa: PLW0603
    _in_use = False


@contextlib.contextmanager
def _folder_that_names(address: str, port: int) -> Iterator[None]:
    """Be in a folder whose settings name the service, while the library reads them."""
    before = os.open(".", os.O_RDONLY)
    with tempfile.TemporaryDirectory(prefix="station-pico-") as folder:
        settings = f"[Client]\nconnectAddr={address}\nconnectPort={port}\n"
        (Path(folder) / "PXREASetting.ini").write_text(settings)
        os.chdir(folder)
        try:
            yield
        finally:
            os.fchdir(before)
            os.close(before)


class QuietStdout:
    """From its construction to `restore` only Python writes to the standard output.

    File descriptor 1 leads to nowhere meanwhile; what Python writes goes on to where it led before.
    """

    def __init__(self) -> None:
        self._python: TextIO | None = None
        self._saved: int | None = None
        try:
            saved = os.dup(_STDOUT)
        except OSError:  # it is closed, as in some services: there is nothing to keep clean
            return
        sys.stdout.flush()
        self._saved = saved
        if _leads_to(sys.stdout, _STDOUT):
            self._python, sys.stdout = sys.stdout, os.fdopen(os.dup(saved), "w", buffering=1)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, _STDOUT)
        os.close(nowhere)

    def restore(self) -> None:
        """Give the standard output back; a second call does nothing."""
        if self._saved is None:
            return
        ctypes.CDLL(None).fflush(None)  # what the C library still holds back must not come out afterwards
        os.dup2(self._saved, _STDOUT)
        os.close(self._saved)
        self._saved = None
        if self._python is not None:
            sys.stdout.close()
            sys.stdout, self._python = self._python, None


def _leads_to(stream: TextIO, descriptor: int) -> bool:
    try:
        return stream.fileno() == descriptor
    except (OSError, AttributeError):  # no file: a test's or a notebook's
        return False
