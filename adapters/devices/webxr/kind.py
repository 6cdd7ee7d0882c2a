"""Any headset or phone as a device: `station serve webxr` serves a page, and what opens it drives.

WebXR wants a page that is on this machine or served with TLS. So there are two ways: a cable (``adb reverse tcp:8771
tcp:8771``, then ``http://localhost:8771`` in the headset), or ``host: 0.0.0.0``, with a certificate that the headset is
told to trust once. A fake is a page without a browser: it sends what a script says over the same socket.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from adapters.devices import pair
from adapters.devices.webxr.controls import CONTROLS, TOUCH_HOLD
from station.bus.address import BusAddress
from station.clock import Clock
from station.operator.device import Source
from station.operator.device_kind import DeviceConfig, DeviceKind
from station.operator.measure import OperatorMeasure
from station.operator.sample import Pose

PORT = 8771


class Palm(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the palm of a right hand is in a controller, from where WebXR has its grip, in our axes.

    The left one is its mirror image.

    Attributes:
        shift_m: To it (3,) [m].
        turn_deg: Rotation vector to it (3,) [degrees].
    """

    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class WebXRConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the page's server, beside `rate_hz` and `fake`.

    Attributes:
        host: Address to serve the page on; on any other than a loopback one with TLS.
        port: Port; 0 takes a free one.
        names: Further names that a browser may open the page as.
        certificate, key: Files of a certificate of your own and its key, as PEM; None for one that is made here.
        cameras: Names of cameras that the operator sees in the headset: one for both eyes, or left and right.
        touch_scale: What the sticks of a touch screen are multiplied by: they are slower than a gamepad's.
        palms: Where the palm is in a controller, by the name of its profile (``meta-quest-touch-plus``), which the
            heartbeat tells; in any other it is where WebXR has the grip. None has been measured yet.
    """

    host: str = "127.0.0.1"
    port: int = PORT
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    cameras: tuple[str, ...] = ()
    touch_scale: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.5
    palms: dict[str, Palm] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        from station.web.config import PageConfig

        PageConfig(host=self.host, port=self.port, names=self.names, certificate=self.certificate, key=self.key)
        if len(self.cameras) > 2:
            raise ValueError(f"cameras are {', '.join(self.cameras)}; expected one for both eyes, or left and right")


@contextlib.contextmanager
def _source(config: WebXRConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    from adapters.devices.webxr.headset import Headset
    from station.web.config import PageConfig
    from station.web.web_server import listen

    where = PageConfig(
        host=config.host, port=config.port, names=config.names, certificate=config.certificate, key=config.key
    )
    listening = listen(where)
    headset = Headset(clock, _palms(config.palms), listening.url, config.touch_scale)

    @contextlib.contextmanager
    def beside(address: BusAddress, name: str) -> Iterator[None]:
        from adapters.devices.webxr.pages import HeadsetPages
        from station.web.operator_view import OperatorView, feeds_of
        from station.web.stops import Stops

        server, cameras = listening.server, feeds_of(config.cameras)
        with contextlib.closing(Stops(address, name)) as stops:
            pages = HeadsetPages(headset, listening, stops, cameras, clock)
            server.start(pages.app)
            stops.warm()
            with OperatorView(
                address,
                name,
                cameras,
                lambda new: server.call(pages.feeds.put, new),
                lambda cue: server.call(pages.tell, cue),
            ):
                yield

    with contextlib.closing(listening.server), contextlib.ExitStack() as stack:
        begin = None
        if config.fake is not None:
            from adapters.devices.fakes.webxr.wearer import FakePage

            fake = stack.enter_context(FakePage(config.fake, listening.url, start_s, listening.authority))
            begin = fake.begin
        yield Source(open=lambda: headset, begin=begin, beside=beside, numbers=headset.numbers)


def _palms(told: Mapping[str, Palm]) -> Mapping[str, Pose]:
    import numpy as np

    from station import rotations

    return {
        profile: Pose(np.array(palm.shift_m), rotations.from_rotation_vector(np.radians(palm.turn_deg)))
        for profile, palm in told.items()
    }


def _measure() -> OperatorMeasure:
    from adapters.retarget.operators import BodyMeasure

    return BodyMeasure()


def _plugged_in() -> Sequence[str]:
    """Return none: a headset comes to us."""
    return ()


def _play(file: Path, port: int | None) -> None:
    from adapters.devices.fakes.webxr.wearer import play_for_person

    play_for_person(file, PORT if port is None else port)


KIND = DeviceKind(
    name="webxr",
    about="any headset's or phone's browser, by a page",
    config=WebXRConfig,
    source=_source,
    library="starlette",
    extra="console",
    example=Path(__file__).parents[1] / "fakes/webxr/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=CONTROLS,
    # A page gets no menu button. Tracked hands have no buttons: the left one's pinch drives while it is held.
    buttons=pair.BUTTONS | {"disarm": "hold right_stick_click", "engage": ["left_pinch", TOUCH_HOLD]},
    port=PORT,
    measure=_measure,
)
