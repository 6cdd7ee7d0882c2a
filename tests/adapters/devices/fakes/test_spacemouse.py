"""The fake spacemouse: scripts under the real hidapi."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.spacemouse import install
from adapters.devices.spacemouse.device import Spacemouse
from station.errors import BadFile
from tests.adapters.devices.by_hand import HandClock

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fake replaces C functions of a Linux library")


def test_the_same_script_gives_the_same_samples_every_time(tmp_path: Path) -> None:
    file = tmp_path / "nod.json"
    steps = [{"at_s": 0.2, "twist": [0.5, 0, 0, 0, 0, 0]}, {"at_s": 0.5, "buttons": [0]}, {"at_s": 0.6, "buttons": []},
             {"at_s": 0.8, "twist": [0] * 6}]  # fmt: skip
    file.write_text(json.dumps({"device": "spacemouse", "period_s": 1.0, "steps": steps}))

    def played() -> list[Any]:
        clock = HandClock()
        fake = install(file, clock)
        device = Spacemouse()
        try:
            samples = []
            for _ in range(250):
                reading = device.read()
                assert reading is not None
                assert reading.twist is not None
                samples.append((reading.twist.tolist(), dict(reading.controls)))
                clock.pass_(0.01)
            return samples
        finally:
            device.close()
            fake.remove()

    first = played()
    assert first == played()
    assert sorted({sample[0][0] for sample in first}) == pytest.approx([0.0, 0.473684210])
    assert sum(sample[1]["button_0"] for sample in first) == 2 * 10


def test_a_bad_script_is_refused_before_anything_is_replaced(tmp_path: Path) -> None:
    file = tmp_path / "bad.json"
    file.write_text('{"device": "spacemouse", "steps": [{"at_s": 0, "report": "zz"}]}')
    with pytest.raises(BadFile, match="step 0"):
        install(file)


@pytest.mark.usefixtures("processes")
def test_a_process_that_ends_without_closing_its_fake_ends_cleanly(tmp_path: Path) -> None:
    file = tmp_path / "rest.json"
    file.write_text('{"device": "spacemouse", "steps": [{"at_s": 0}]}')
    code = (
        "import sys; from pathlib import Path\n"
        "from adapters.devices.fakes.spacemouse import install\n"
        "from adapters.devices.spacemouse.device import Spacemouse\n"
        "import gc; install(Path(sys.argv[1])); gc.collect()  # nobody remembers it\n"
        "device = Spacemouse(); gc.collect(); print(device.read().twist.tolist())"
    )
    ended = subprocess.run([sys.executable, "-c", code, file], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout.strip(), ended.stderr) == (0, str([0.0] * 6), "")
