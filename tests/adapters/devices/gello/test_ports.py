"""Which ports are leaders, and what their adapters are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.devices.gello import ports
from adapters.devices.serial_port import serial_of


def test_the_serial_number_of_a_port_is_found_by_either_name(tmp_path: Path) -> None:
    tty, by_id = tmp_path / "ttyUSB0", tmp_path / "by-id"
    tty.touch()
    by_id.mkdir()
    assert serial_of(str(tty), by_id) == "ttyUSB0"
    name = by_id / "usb-FTDI_USB__-__Serial_Converter_FT8ISUJY-if00-port0"
    name.symlink_to(tty)
    assert serial_of(str(name), by_id) == "FT8ISUJY"
    assert ports.plugged_in(by_id) == [f"adapter FT8ISUJY at {name}"]
    assert serial_of(str(tty), by_id) == "FT8ISUJY"


def test_adapters_are_looked_for_by_whose_servos_are_behind_them(tmp_path: Path) -> None:
    (tmp_path / "usb-FTDI_USB__-__Serial_Converter_FT8ISUJY-if00-port0").touch()
    name = tmp_path / "usb-1a86_USB_Single_Serial_5A7C116959-if00"
    name.touch()
    assert ports.choose((), 1, tmp_path, "feetech") == [str(name)]
    assert ports.choose((), 1, tmp_path) != [str(name)]
    assert f"adapter 5A7C116959 at {name}" in ports.plugged_in(tmp_path)
    assert len(ports.plugged_in(tmp_path)) == 2


def test_an_adapter_that_holds_bytes_back_is_told_with_the_rule(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ports, "_LATENCY", str(tmp_path / "{tty}"))
    (tmp_path / "ttyUSB0").write_text("16\n")
    (tmp_path / "ttyUSB1").write_text("1\n")
    assert 'ATTR{latency_timer}="1"' in ports.latency_advice("/dev/ttyUSB0")
    assert ports.latency_advice("/dev/ttyUSB1") == ""
    assert ports.latency_advice("/dev/ttyUSB2") == ""
