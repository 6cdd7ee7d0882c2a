"""Ports that may be gloves, as a person is told; and ports that cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove import ports
from adapters.devices.glove.ports import GlovePort
from station.operator.device import DeviceError
from tests.adapters.devices.glove.serial_line import NAME
from tests.adapters.devices.glove.test_device import calibration


def test_an_adapter_is_listed_with_what_it_was_calibrated_as(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    assert ports.plugged_in(by_id) == []
    names = (NAME.format("GL1"), NAME.format("GL2"), "usb-FTDI_USB__-__Serial_Converter_FT7-if00-port0")
    for name in names:
        (by_id / name).touch()
    for side in ("left", "right"):
        calibrations.save(calibrations.default_folder(), calibration("GL2", side))
    assert ports.plugged_in(by_id) == [
        f"adapter GL1 at {by_id / names[0]}, not calibrated as a glove",
        f"adapter GL2 at {by_id / names[1]}, calibrated as the left and the right glove",
    ], "what is named like the adapter of a leader arm is one until it is calibrated as a glove"


def test_calibrating_takes_the_only_adapter(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="plug the glove in, or name its port with --port"):
        ports.only_adapter(tmp_path)
    (tmp_path / NAME.format("GL1")).touch()
    assert ports.only_adapter(tmp_path) == str(tmp_path / NAME.format("GL1"))
    (tmp_path / NAME.format("GL2")).touch()
    with pytest.raises(DeviceError, match=r"2 adapters found: .*GL1.*GL2.*; choose one with --port"):
        ports.only_adapter(tmp_path)


@pytest.mark.parametrize(
    ("port", "told"),
    [("/dev/ttyNONE", "/dev/ttyNONE: no such port; plug the glove in, or name another with port:"),
     ("/", "cannot be opened"), ("/dev/null", "cannot be opened")],
)  # fmt: skip
def test_a_port_that_cannot_be_used_is_one_line(port: str, told: str) -> None:
    with pytest.raises(DeviceError) as caught:
        GlovePort(port, 115_200)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
