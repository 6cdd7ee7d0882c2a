"""``station devices calibrate pico`` with the real library on a fake service, as a user types it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.devices.fakes.pico.play import Wearer
from adapters.devices.fakes.pico.script import KeyFrame, Script, Skeleton
from adapters.devices.fakes.pico.service import PicoService
from adapters.retarget import calibration
from adapters.retarget.human import of_height, standing
from station.operator.sample import Body
from tests.cli.at_terminal import AtTerminal
from tests.cli.running import Home, one_line
from tests.waiting import wait_until

CALIBRATE = ("devices", "calibrate", "pico", "--operator", "ada")
EXAMPLE = "adapters/devices/fakes/pico/t-pose.json"
PERIOD_S = 0.014


@pytest.fixture(autouse=True)
def kept(home: Home, tmp_path: Path) -> Path:
    """The file of the operator who is measured."""
    home.environment["XDG_CONFIG_HOME"] = str(tmp_path)
    return tmp_path / "station" / "operators" / "ada.yaml"


def script(body: Body) -> Script:
    skeleton = Skeleton(positions=body.positions.tolist(), quats_wxyz=body.quats_wxyz.tolist())
    return Script(frames=[KeyFrame(at_s=0.0, body=skeleton)])


class Person:
    """Somebody of 1.66 m in a T-pose who wears a headset; walks about until told to stand still."""

    def __init__(self) -> None:
        self.service = PicoService(0)
        self.is_still = False
        here = standing(of_height(1.66))
        there = replace(here, positions=here.positions + np.array([0.3, 0.0, 0.0]))
        self._worn = [Wearer(script(body)) for body in (here, there)]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._wear, daemon=True)
        self._thread.start()

    def _wear(self) -> None:
        began_ns, number = time.time_ns(), 0
        while not self._over.wait(PERIOD_S):
            number += 1
            worn = self._worn[0 if self.is_still else number // 10 % 2]
            if (frame := worn.frame(number, began_ns)) is not None:
                self.service.send(frame)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.service.stop()


@pytest.fixture
def person() -> Iterator[Person]:
    made = Person()
    yield made
    made.close()


def test_an_operator_is_measured_with_nothing_but_a_fake(home: Home, kept: Path) -> None:
    done = home.run(*CALIBRATE, "--yes", "--count", "1", "--set", f"fake={EXAMPLE}")
    assert (done.returncode, done.stderr) == (0, "")
    assert "1 … stand still\n\nada is 1.75 m tall, measured in " in done.stdout
    (leg,) = (line.split() for line in done.stdout.splitlines() if line.startswith("leg "))
    assert leg == ["leg", "0.859", "m", "0.654", "m", "0.76"]
    assert f"kept: {kept}\n" in done.stdout
    assert "--set teleop.driver=body --set teleop.operator=ada" in done.stdout
    found = calibration.load(kept)
    assert (found.device, found.source, found.pose) == ("pico", "a fake that plays t-pose.json", "t-pose")
    assert found.height_m == pytest.approx(1.75, abs=0.01)
    assert not home.bus_is_there(), "it takes with it what it started"


def measured_until(terminal: AtTerminal, text: str, place: int = 0) -> int:
    """Press Enter when asked to, until a text is there; return its place. A busy machine may hear nothing at first."""
    while text not in terminal.screen[place:]:
        asked = terminal.wait_for("Enter when ready", place)
        terminal.type(b"\n")
        place = terminal.wait_for("stand still", asked)
        terminal.wait_for_any(text, "Enter when ready", after=place)
    return terminal.screen.index(text, place)


def test_at_a_terminal_it_listens_to_a_running_server_and_tries_again_until_somebody_stands_still(
    home: Home, kept: Path, person: Person
) -> None:
    kept.parent.mkdir(parents=True)
    kept.write_text("the one before")
    with home.running("bus", "start"):
        wait_until(home.bus_is_there)
        with home.running("serve", "pico", "--set", f"port={person.service.port}") as server:
            wait_until(lambda: "pico" in home.pids())
            refused = one_line(home.run(*CALIBRATE, "--yes", "--set", "port=1"))
            assert refused == "--set port=1: server 'pico' runs already and is listened to; stop it first"
            with AtTerminal(home, *CALIBRATE, "--count", "0") as terminal:
                terminal.wait_for("listening to pico on ")
                place = measured_until(terminal, "moved by 0.")
                person.is_still = True
                measured_until(terminal, f"{kept} is there; replace it? [y/N]", place)
                assert kept.read_text() == "the one before"
                terminal.type(b"y\n")
                assert terminal.finish() == 0, terminal.screen
            assert "ada is 1.66 m tall" in terminal.screen
            assert server.process.poll() is None, "it goes on"
    found = calibration.load(kept)
    assert found.source.startswith("library xrobotoolkit-sdk ")


def test_while_a_body_is_not_tracked_it_waits_and_says_so_and_ctrl_c_keeps_nothing(home: Home, kept: Path) -> None:
    file = kept.parents[2] / "nobody.json"
    file.write_text(json.dumps({"frames": [{"at_s": 0, "head": [0, 0, 1.6, 1, 0, 0, 0]}]}))
    with AtTerminal(home, *CALIBRATE, "--yes", "--count", "0", "--within", "600", "--set", f"fake={file}") as terminal:
        terminal.wait_for(
            "waiting: the body is not tracked; are the trackers on, and is body tracking started in the headset?"
        )
        terminal.type(b"\x03")
        assert terminal.finish() == 130
    assert "Traceback" not in terminal.screen
    assert not kept.exists()


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        ([], 2, "there is no terminal to ask in; --yes measures without asking"),
        (["--operator", "../ada", "--yes"], 2, "operator: '../ada' is no name"),
        (["--pose", "sitting"], 2, "'sitting' is not one of 't', 'standing'"),
        (["--yes", "--set", "fke=x.json"], 2, "--set of the pico server: unknown key 'fke' (did you mean 'fake'?)"),
        (["--yes", "--set", "fake=none.json"], 1, "none.json: cannot be read: No such file or directory"),
        (["--yes", "--bus", "unix:///none.sock"], 1, "bus unix:///none.sock"),
    ],
)
def test_a_mistake_is_one_line(home: Home, arguments: list[str], code: int, told: str) -> None:
    done = home.run(*CALIBRATE, *arguments)
    assert told in one_line(done)
    assert done.returncode == code
