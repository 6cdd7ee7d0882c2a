"""The Pico server: headset, controllers, body and hands of an operator, through XRoboToolkit's PC service.

It only translates (`adapters.devices.pico`) and says how fresh its data are (`station.operator.serve`); it knows no
robot. Beside the keys of an operator it writes stock TWIST2's `controller_data`. The library may take the process down
with it; a runbook has the server started again (``if_it_dies: restart``), which moves nothing by itself.

With ``fake: FILE`` it starts a fake PC service that plays a script (`adapters.devices.fakes.pico`), on a free port of
its own; the rest is the same, the real library included. The script begins when the server becomes active, and goes on
where it was after a restart.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.pico.headset import DEFAULT_PORT, Headset
from adapters.devices.pico.stock import controller_data
from adapters.robots.g1 import twist_keys
from station import python_child
from station.bus import codec
from station.config import to_plain
from station.errors import NotReady
from station.life.server import Life, ServerKind
from station.operator import script_time
from station.operator.reading import Reading
from station.operator.serve import serve_device

_FAKE_ENDS_S = 5.0


class PicoConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the Pico server.

    Attributes:
        rate_hz: Looks at the headset per second [Hz]; it sends 72 or 90 samples, and none is written twice.
        address: Where XRoboToolkit's PC service is.
        port: Its TCP port.
        fake: Script of a fake headset, played in place of a real one.
    """

    rate_hz: float = 100.0
    address: str = "127.0.0.1"
    port: int = DEFAULT_PORT
    fake: Path | None = None

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz")
        if not 1 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 1 to 65535")
        if not self.address or not self.address.isprintable() or " " in self.address:
            raise ValueError(f"address is {self.address!r}; expected a host name or an IP address")


def main(config: PicoConfig, life: Life) -> int:
    """Publish what the headset gives until asked to stop; return the exit code."""
    with contextlib.ExitStack() as stack:
        fake = stack.enter_context(_fake(config.fake, script_time.now_s(life))) if config.fake is not None else None
        address, port = ("127.0.0.1", fake.port) if fake is not None else (config.address, config.port)
        return serve_device(
            life,
            lambda: Headset(address, port, clock=life.clock),
            rate_hz=config.rate_hz,
            config=to_plain(config),
            also=_stock,
            on_active=fake.begin if fake is not None else None,
        )


KIND = ServerKind(
    name="pico",
    role="sensor",
    summary="reads a Pico headset: controllers, buttons, body and hands of an operator",
    config=PicoConfig,
    main=main,
)


def _stock(reading: Reading) -> Mapping[str, bytes]:
    return {twist_keys.CONTROLLER_DATA: codec.json_object(controller_data(reading))}


class _Fake:
    """A fake PC service in a process of its own, which ends when we do."""

    def __init__(self, process: subprocess.Popen[bytes], port: int, start_s: float) -> None:
        self._process, self.port, self._start_s = process, port, start_s

    def begin(self) -> Mapping[str, Any]:
        """Let the script begin; return since when it runs, for the next life of this server."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is gone: the headset is lost, and says so
            self._process.stdin.write(b"go\n")
            self._process.stdin.flush()
        return script_time.began(self._start_s)


@contextlib.contextmanager
def _fake(script: Path, start_s: float) -> Iterator[_Fake]:
    """Start a fake PC service.

    Raises:
        BadFile: the script cannot be read; the message names file and field.
        NotReady: it does not listen.
    """
    from adapters.devices.fakes.pico.script import load

    load(script)  # a mistake in it is told here, in one line, and not by a child
    arguments = [str(script), "--port", "0", "--on-leash", "--start-s", repr(start_s)]
    command = python_child.command("-m", "adapters.devices.fakes.pico", *arguments)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            words = process.stdout.readline().split()
            if len(words) != 2:
                raise NotReady(f"the fake PC service ended before it was listening (exit code {process.wait()})")
            yield _Fake(process, int(words[1]), start_s)
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_FAKE_ENDS_S)
            process.kill()
