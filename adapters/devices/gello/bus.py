"""A bus of Dynamixel or Feetech servos through the maker's own library, with errors that say what to do."""

from __future__ import annotations

import importlib
import math
import select
import termios
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from adapters.devices.serial_port import PortGone, why_gone, why_not_open
from station.clock import SYSTEM, Clock
from station.operator.device import DeviceError
from station.protocols import Floats

Servos = Literal["dynamixel", "feetech"]

RAD_PER_TICK = math.pi / 2048.0

_NAP_S = 0.002


class NoSuchRate(DeviceError):
    """The library or the adapter cannot do a baud rate."""


class MotorBus(ABC):
    """An open serial port with servos of one maker.

    Not for several threads at once.

    Args:
        port: Its name, best one of ``/dev/serial/by-id``.
        baud: Its rate [bit/s].
        clock: Of the process; the library's time-outs are by it.
        device, setting: For errors: what has the servos, as a person says it, and the setting that names its port.

    Attributes:
        servos: The maker.
        library: The package that speaks to its servos.
        bauds: The rates that leaders are used at, the most usual first [bit/s].
        models: Names of its servos by model number.

    Raises:
        DeviceError: no such port, no permission, in use by another process, a rate that the library does not know, or
            no library.
    """

    servos: ClassVar[Servos]
    library: ClassVar[str]
    bauds: ClassVar[tuple[int, ...]]
    models: ClassVar[Mapping[int, str]]

    _module: ClassVar[str]
    _protocol: ClassVar[float]
    _position: ClassVar[tuple[int, int]]
    """Address of the present position, and its bytes."""

    def __init__(
        self, port: str, baud: int, clock: Clock = SYSTEM, *, device: str = "leader", setting: str = "ports"
    ) -> None:
        self.port, self.baud, self.clock, self._device, self._setting = port, baud, clock, device, setting
        self._sdk = _imported(self._module, self.library, device)
        self._handler = self._open(port, baud)
        self._packets = self._sdk.PacketHandler(self._protocol)
        self._reader: Any = None
        self._reader_ids: tuple[int, ...] = ()

    def ping(self, ids: Iterable[int], attempts: int = 8) -> dict[int, int]:
        """Return the model numbers of those servos that answer one of some pings; 35 ms for each that is not answered.

        Raises:
            PortGone: the port was torn out.
        """
        found = {}
        for id_ in ids:
            for _ in range(attempts):
                model = self._model_of(id_)
                if model is not None:
                    found[id_] = model
                    break
        return found

    @abstractmethod
    def scan(self) -> dict[int, int]:
        """Return the model numbers of all servos that answer, by id; takes 1 to 2 s.

        Raises:
            PortGone: the port was torn out.
        """

    def positions(self, ids: Sequence[int]) -> Floats | None:
        """Return the present positions [rad], shape (len(ids),), 2048 ticks to half a turn; None when one is silent.

        Raises:
            PortGone: the port was torn out.
        """
        if self._reader_ids != tuple(ids):
            self._reader = self._sdk.GroupSyncRead(self._handler, self._packets, *self._position)
            for id_ in ids:
                self._reader.addParam(id_)
            self._reader_ids = tuple(ids)
        if self._guarded(self._reader.txRxPacket) != self._sdk.COMM_SUCCESS:
            return None
        if not all(self._reader.isAvailable(id_, *self._position) for id_ in ids):
            return None  # an answer without the number, of which the library would make 0
        try:
            ticks = [self._ticks(id_, self._reader.getData(id_, *self._position)) for id_ in ids]
        except IndexError:  # an answer to something else, of before, that came late: it has no number
            return None
        return np.array(ticks, dtype=np.float64) * RAD_PER_TICK

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        if self._handler.is_open:
            self._handler.closePort()

    @abstractmethod
    def _model_of(self, id_: int) -> int | None:
        """Ping a servo once; return its model number, None when it is silent."""

    @abstractmethod
    def _ticks(self, id_: int, raw: int) -> int:
        """Return the signed position of a servo, 4096 to a turn, for the unsigned number that the library gives."""

    def _guarded(self, call: Any, *arguments: Any) -> Any:
        """Call the library; it lets through whatever its serial port raises, and then never speaks again."""
        try:
            return call(*arguments)
        except (OSError, termios.error, TypeError, ValueError) as error:  # pyserial's own errors are OSErrors
            self._handler.is_using = False
            raise PortGone(why_gone(self.port, error, device=self._device)) from None

    def _open(self, port: str, baud: int) -> Any:
        handler = _patient(self._sdk, self.clock)(port)
        try:
            is_open = handler.setBaudRate(baud)
            if is_open:
                handler.ser.exclusive = True  # two that read one port would tear each other's packets
        except OSError as error:
            raise DeviceError(why_not_open(port, error, device=self._device, setting=self._setting)) from None
        except ValueError as error:  # pyserial's, at rates that the system has no constant for
            raise NoSuchRate(f"{port}: its adapter cannot do {baud} baud ({error}); name another rate") from None
        if not is_open:
            rates = ", ".join(map(str, self.bauds))
            raise NoSuchRate(f"{port}: no such baud rate: {baud}; GELLO's {self.servos} servos use {rates}")
        return handler


class DynamixelBus(MotorBus):
    """Of Dynamixel servos, which speak protocol 2.0 and count their turns while they have power."""

    servos = "dynamixel"
    library = "dynamixel-sdk"
    bauds = (57600, 1_000_000, 115_200, 2_000_000, 3_000_000, 4_000_000)
    models = {  # noqa: RUF012
        1020: "XM430-W350", 1060: "XL430-W250", 1190: "XL330-M077", 1200: "XL330-M288", 1220: "XC330-T288",
    }  # fmt: skip

    _module, _protocol, _position = "dynamixel_sdk", 2.0, (132, 4)

    def scan(self) -> dict[int, int]:
        """Return the model numbers of all servos that answer a ping to all of them, by id; takes 1 to 2 s.

        Raises:
            PortGone: the port was torn out.
        """
        found, _ = self._guarded(self._packets.broadcastPing, self._handler)
        return {id_: facts[0] for id_, facts in sorted(found.items())}

    def write(self, id_: int, address: int, value: int) -> bool:
        """Set a byte of a servo; return whether it said that it did.

        Raises:
            PortGone: the port was torn out.
        """
        result, error = self._guarded(self._packets.write1ByteTxRx, self._handler, id_, address, value)
        return bool(result == self._sdk.COMM_SUCCESS and not error)

    def write_together(self, address: int, values: Mapping[int, int]) -> None:
        """Set four bytes of several servos at once, by id; no servo answers.

        Raises:
            PortGone: the port was torn out.
        """
        writer = self._sdk.GroupSyncWrite(self._handler, self._packets, address, 4)
        for id_, value in values.items():
            writer.addParam(id_, value.to_bytes(4, "little", signed=True))
        self._guarded(writer.txPacket)

    def _model_of(self, id_: int) -> int | None:
        model, result, _ = self._guarded(self._packets.ping, self._handler, id_)
        return model if result == self._sdk.COMM_SUCCESS else None

    def _ticks(self, id_: int, raw: int) -> int:
        return raw - (1 << 32) if raw & 1 << 31 else raw  # half a turn back is no four thousand million ticks ahead


class FeetechBus(MotorBus):
    """Of Feetech's STS servos, which count from 0 to 4095 and begin anew after a turn.

    `positions` goes on counting where a servo begins anew: each position is on the turn nearest to the one before of
    the same servo, the first as the servo shows it. So a servo must not turn by half a turn between two readings; one
    that is set to count its turns itself (bit 4 of address 18) is believed.

    Never tried on real servos. Look first whether all answer a sync read in time, in the order in which they are asked.
    """

    servos = "feetech"
    library = "feetech-servo-sdk"
    bauds = (1_000_000, 500_000, 250_000, 128_000, 115_200, 57_600, 38_400)
    models = {777: "STS3215"}  # noqa: RUF012

    _module, _protocol, _position = "scservo_sdk", 0, (56, 2)  # 0: numbers begin with their low byte, as those of STS
    _MODEL = (3, 2)
    _SIGN_BIT = 1 << 15
    _TURN = 4096
    _IDS = range(1, 21)

    def __init__(
        self, port: str, baud: int, clock: Clock = SYSTEM, *, device: str = "leader", setting: str = "ports"
    ) -> None:
        super().__init__(port, baud, clock, device=device, setting=setting)
        self._last: dict[int, int] = {}

    def scan(self) -> dict[int, int]:
        """Return the model numbers of the servos 1 to 20 that answer, by id; takes 1.5 s when none does.

        The library has no ping to all of them.

        Raises:
            PortGone: the port was torn out.
        """
        return self.ping(self._IDS, attempts=2)

    def _model_of(self, id_: int) -> int | None:
        """Read the model: the library's ping does too, and falls over an answer that is too short."""
        data, result, _ = self._guarded(self._packets.readTxRx, self._handler, id_, *self._MODEL)
        is_whole = result == self._sdk.COMM_SUCCESS and len(data) == 2
        return int.from_bytes(bytes(data), "little") if is_whole else None

    def _ticks(self, id_: int, raw: int) -> int:
        shown = -(raw - self._SIGN_BIT) if raw & self._SIGN_BIT else raw
        last = self._last.get(id_, shown)
        self._last[id_] = shown + round((last - shown) / self._TURN) * self._TURN
        return self._last[id_]


BUSES: dict[Servos, type[MotorBus]] = {"dynamixel": DynamixelBus, "feetech": FeetechBus}


def model_name(number: int) -> str:
    """Return what a model number stands for."""
    names = {model: name for bus in BUSES.values() for model, name in bus.models.items()}
    return names.get(number, f"model {number}")


def _imported(module: str, package: str, device: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise DeviceError(
            f"a {device} needs {package}, which is not installed; pip install 'teleop-station[gello]'"
        ) from None


def _patient(sdk_: Any, clock: Clock) -> Any:
    """Return the library's port, but one that sleeps until bytes come where the original spins; whose time-outs are no
    matter of the wall clock, which may be set; and that lets nothing which came late answer the next question."""

    class PatientPort(sdk_.PortHandler):  # type: ignore[misc]
        def readPort(self, length: int) -> Any:  # noqa: N802
            if length > 0 and self.ser.in_waiting == 0:
                select.select([self.ser.fileno()], [], [], _NAP_S)
            return super().readPort(length)

        def clearPort(self) -> None:  # noqa: N802  before each question; Feetech's leaves what came in
            self.ser.reset_input_buffer()

        def getCurrentTime(self) -> float:  # noqa: N802  milliseconds
            return clock.monotonic_ns() * 1e-6

    return PatientPort
