"""The wheel holds all that the station is: it runs from an empty folder, where nothing of a checkout can be found."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import wheels
from tests.cli.running import SHORT, Home, new_home

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILD = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]
PACKAGES: list[str] = BUILD["wheel"]["packages"]
ELSEWHERE: list[str] = BUILD["wheel"]["exclude"]

pytestmark = pytest.mark.timeout(300)  # a cold start of everything, on a busy machine

DRY_RUNS = """
import station
from station import packages
from station.cli.main import cli
from station.errors import StationError
print(station.__file__)
for book in packages.RUNBOOKS.glob("*.yaml"):
    try:
        cli.main(["up", "--dry-run", book.stem], standalone_mode=False)
    except StationError as error:
        if "it is not part of the station: take it from" not in str(error):
            raise
        print("asks", book.name)
    else:
        print("planned", book.name)
"""

THIRD_PARTY = '''
"""A policy and a device of a third party, as a strict type checker sees them."""

from pathlib import Path

import numpy as np

from adapters.commands.twist2 import FORMAT
from servers.recorder import KIND
from station import assets, registry
from station.bus.client import Bus
from adapters.robots.g1.twist_keys import action_body
from station.bus.sample import Sample
from station.errors import StationError, UnknownName
from station.life.server import Life, ServerKind
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState


class Standing:
    """Asks for the default pose."""

    def __init__(self, checkpoint: Path) -> None:
        joints = ("left_knee", "right_knee")
        zeros: Floats = np.zeros(len(joints))
        self._spec = PolicySpec(
            name="standing", checkpoint=checkpoint, sha256=assets.sha256(checkpoint), runtime="none", rate_hz=50.0,
            command="twist2", joint_names=joints, default_q=zeros, kp=zeros, kd=zeros,
            observation_size=2, action_size=2,
        )

    @property
    def spec(self) -> PolicySpec:
        return self._spec

    def reset(self) -> None: ...

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        return state.q.astype(np.float32)

    def act(self, observation: Floats32) -> Floats32:
        return observation

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        return JointTargets(self.spec.default_q, self.spec.kp, self.spec.kd)

    def restore(self, observation: Floats32) -> None: ...


class Dial:
    """Reads a dial."""

    def read(self) -> OperatorSample | None:
        raise DeviceError("no dial; plug it in")


def newest(bus: Bus) -> Sample | None:
    return bus.read([action_body()]).get(action_body())


def role(name: str) -> str:
    try:
        kind: ServerKind = registry.find("server", name)
    except UnknownName as error:
        raise StationError(f"{error}; known: {', '.join(error.known)}") from error
    return kind.role


def wait(life: Life) -> bool:
    return life.stopping


policy: Policy = Standing(Path("standing.onnx"))
reveal_type(KIND)
reveal_type(FORMAT)
reveal_type(registry.names("server"))
'''


@pytest.fixture(scope="module")
def built_wheel(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built of this checkout."""
    return wheels.build(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def python(built_wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter where the wheel is installed; what it depends on is that of the tests."""
    return wheels.install(built_wheel, tmp_path_factory.mktemp("installed") / "env")


@pytest.fixture
def home(python: Path) -> Iterator[Home]:
    with new_home() as made:
        wheels.use(made, python)
        yield made


def run(home: Home, folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        command, cwd=folder, env=home.environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert list(folder.iterdir()) == []
    return done


def test_every_file_of_our_packages_is_in_the_wheel(built_wheel: Path) -> None:
    packed = set(zipfile.ZipFile(built_wheel).namelist())
    files = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    wanted = {name for name in files if not name.startswith(tuple(f"{folder}/" for folder in ELSEWHERE))}
    wanted |= {f"station/docs/{path.name}" for path in (ROOT / "docs").glob("*.md")}
    assert wanted - packed == set()
    assert {name.partition("/")[0] for name in packed} == {*PACKAGES, f"teleop_station-{PROJECT['version']}.dist-info"}
    assert {name.rpartition("/")[2] for name in packed if "/licenses/" in name} == {"LICENSE", "NOTICE"}


def test_every_runbook_can_be_planned_in_an_empty_folder(python: Path, home: Home, tmp_path: Path) -> None:
    done = run(home, tmp_path / "empty", str(python), "-c", DRY_RUNS)
    assert done.returncode == 0, done.stderr
    used, *_ = done.stdout.splitlines()
    assert Path(used).is_relative_to(python.parents[1])
    planned, asking = (re.findall(f"^{word} (.*)$", done.stdout, re.MULTILINE) for word in ("planned", "asks"))
    assert sorted([*planned, *asking]) == sorted(path.name for path in (ROOT / "runbooks").glob("*.yaml"))
    assert sorted(asking) == [
        "g1-cockpit-sim.yaml",
        "g1-falcon-sim.yaml",
        "g1-homie-sim.yaml",
        "go1-sim-gamepad.yaml",
        "h1-sim-gamepad.yaml",
    ], "for the file of a policy that is no part of the station"


def test_a_robot_walks_is_recorded_and_checked_in_an_empty_folder(python: Path, home: Home, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    demo = run(home, empty, "station", "demo", "--for", "1s", *SHORT)
    assert "Traceback" not in demo.stdout + demo.stderr
    (episode,) = (home.data / "demo").iterdir()
    assert {"signals.mcap", "manifest.yaml", "contact-sheet.png"} <= {path.name for path in episode.iterdir()}, demo
    assert f"{episode.name}: " in run(home, empty, "station", "check", "latest").stdout
    page = tmp_path / "page.html"
    assert run(home, empty, "station", "report", "latest", "--out", str(page)).returncode == 0
    assert "<style>" in page.read_text()
    assert run(home, empty, "station", "docs", "first-episode").stdout.startswith("# Record a first episode")
    doctor = run(home, empty, "station", "doctor").stdout
    assert f"teleop-station {PROJECT['version']}" in doctor
    assert "✗ package" not in doctor
    assert "! package" not in doctor


def test_a_strict_type_checker_knows_our_types(python: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    module = tmp_path / "third_party.py"
    module.write_text(THIRD_PARTY)
    config = tmp_path / "mypy.ini"  # types of torch, which no line here needs, take three times as long as all others
    config.write_text("[mypy]\n[mypy-torch.*]\nfollow_imports = skip\n")
    assert request.config.cache is not None
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file", str(config), "--python-executable", str(python),
         "--cache-dir", str(request.config.cache.mkdir("types-of-the-wheel")), str(module)],
        cwd=tmp_path, env={name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MYPYPATH")},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    told = [line for line in done.stdout.splitlines() if "error:" in line]
    assert told == [], done.stdout
    assert re.findall('Revealed type is "(.*)"', done.stdout) == [
        "station.life.server.ServerKind", "adapters.commands.body.BodyCommand", "list[str]",
    ]  # fmt: skip


def test_the_extra_all_has_every_library_that_a_user_may_want() -> None:
    """All but the tools of tests and docs, and those that train a policy."""
    extras: dict[str, list[str]] = PROJECT["optional-dependencies"]
    (everything,) = extras["all"]
    assert set(re.split("[][,]", everything)[1:-1]) == set(extras) - {"all", "docs", "test", "train"}


def test_what_asks_for_an_extra_names_one_that_there_is() -> None:
    asked = {
        extra: path.name
        for folder in ("station", "servers", "adapters", "docs")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".md")
        for group in re.findall(r"teleop-station\[([\w,]+)\]", path.read_text(encoding="utf-8"))
        for extra in group.split(",")
    }
    assert asked.keys() <= PROJECT["optional-dependencies"].keys()
    assert {"retarget", "video", "ray", "torch"} <= asked.keys()
