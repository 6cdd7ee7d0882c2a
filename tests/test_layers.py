"""What `lint-imports` cannot ask: the table of rooms is true, what is heavy loads late, a key is spelled once."""

from __future__ import annotations

import ast
import graphlib
import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grimp
import pytest

from adapters.robots.g1 import twist_keys
from station import registry
from station.bus.address import BusAddress
from station.cli.main import VERBS, module_of

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
HEAVY = (
    "av", "dynamixel_sdk", "foxglove", "grpc", "hid", "hidraw", "matplotlib", "mink", "mujoco", "onnxruntime", "pooch",
    "pandas", "polars", "pygame", "pyrealsense2", "rerun", "rosbags", "scservo_sdk", "serial", "simplejpeg",
    "station_kord", "torch", "xrobotoolkit_sdk", "zarr", "zmq",
)  # fmt: skip

IMPORTED = ("station", "adapters", "servers", "benchmarks", "research", "manifests", "bridges.kord.station_kord")

NO_VERBS = {
    "__init__", "calibrate_operator", "candidates", "compact", "fields", "keyboard", "log_lines", "main", "options",
    "quality", "tables", "terminal_ui", "tidy",
}  # fmt: skip
"""Modules of `station.cli` that verbs share."""

A_KEY = re.compile(
    r"(action_(body|hand|neck|mimic|joints)|state_(body|hand|neck|joints|tcp|counters|controller)|robot_state|policy_(obs|action|timing)|target|sim_qpos|root_velocity"
    r"|command_(gate|used|timing|source))_(?=$|\{|g1|unitree|kassow)"
    r"|^operator_(status|controls|head|left|right|body_(pos|quat)|hand_(left|right)|twist|joints)_(?=$|\{)"
    r"|^camera_(image|depth)_(?=$|\{)|^lidar_(cloud|imu)_(?=$|\{)|^(action|state)_$"
    r"|^station:\S|^t_(action|state)$|^controller_data$"
    r"|^motion_(start|exit)_signal$|" + twist_keys.TWIST2_ROBOT
)
SPELLS_KEYS = ("station/bus/keys.py", "adapters/robots/g1/twist_keys.py")
NO_KEYS = {("station/episode/storage/layout.py", "station:recorder:stamps")}
"""A topic of a file, which no bus ever sees."""


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def contracts() -> dict[str, dict[str, Any]]:
    """Return the import contracts that `lint-imports` checks, by their id."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    return {contract["id"]: contract for contract in listed}


def test_every_room_of_the_station_has_an_import_contract_and_a_true_row_in_architecture() -> None:
    rooms = {path.name for path in (ROOT / "station").iterdir() if (path / "__init__.py").is_file()} - {"cli"}
    importers = {name: contract.get("allowed_importers", []) for name, contract in contracts().items()}
    unprotected = [room for room in rooms if contracts().get(room, {}).get("protected_modules") != [f"station.{room}"]]
    assert unprotected == []
    wrong = []
    for room in sorted(rooms):
        allowed = {name for name in rooms | {"rehearse"} if f"station.{room}" in importers[name]}
        row = re.search(rf"^\| `station/{room}/` \|.*\|([^|]*)\|$", ARCHITECTURE, re.MULTILINE)
        listed = set(re.findall(r"`(\w+)`", row[1])) if row else None
        if listed != allowed:
            wrong.append(f"station/{room}/: the table says {listed}, pyproject.toml {allowed}")
    assert wrong == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Late imports and those of types alone count too: `lint-imports` compares rooms, not their files."""
    graph = grimp.build_graph(*IMPORTED, cache_dir=None)
    imported = {name: graph.find_modules_directly_imported_by(name) - {name} for name in graph.modules}
    assert len(list(graphlib.TopologicalSorter(imported).static_order())) > 800


def test_only_one_module_spells_the_keys_of_the_bus() -> None:
    spelled = [
        (name, text)
        for path in sources("station", "servers", "adapters")
        for name in [str(path.relative_to(ROOT))]
        for text in sorted(set(strings(path)))
        if A_KEY.search(text) and name not in SPELLS_KEYS and (name, text) not in NO_KEYS
    ]
    assert spelled == []


def strings(path: Path) -> Iterator[str]:
    """Yield every string of a file that is no docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


def test_the_pattern_knows_every_key() -> None:
    spelled = [
        text
        for name in SPELLS_KEYS
        for text in strings(ROOT / name)
        if text not in ("", "@", "_", "station:", twist_keys.TWIST2_ROBOT, twist_keys.TWIST_ROBOT)
    ]
    assert spelled
    assert [text for text in spelled if not A_KEY.search(text)] == []


A_ROBOT = re.compile(r"g1\b|kassow|unitree|kr810|twist2|(?<!_)\b(left_|right_)?(hip|knee|ankle|waist|wrist)(_|\b)")
NAMES_ROBOTS = {
    "station/bus/joints.py": "joints of a person",
    "station/suite/promise.py": "motions that a policy is judged by",
    "station/suite/commands.py": "joints of arms by what arms have",
    "station/supervision/doctor.py": "commands that it suggests",
    **dict.fromkeys((f"station/cli/{verb}.py" for verb in ("demo", "kassow", "main", "status")), "verbs"),
}
"""Files of the station that may, and why."""


def test_the_station_knows_no_robot() -> None:
    spelled = {
        str(path.relative_to(ROOT)): found
        for path in sources("station")
        if (found := sorted(text for text in set(strings(path)) if A_ROBOT.search(text)))
    }
    assert {name: found for name, found in spelled.items() if name not in NAMES_ROBOTS} == {}
    assert set(NAMES_ROBOTS) <= set(spelled), "no longer needed"


def test_every_module_of_the_command_line_is_a_verb_or_shared() -> None:
    modules = {path.stem for path in sources("station/cli")}
    assert modules == {module_of(verb).rpartition(".")[2] for verb in VERBS} | NO_VERBS
    for verb in VERBS:
        command = importlib.import_module(module_of(verb)).command
        assert command.name == verb
        assert command.help, f"station {verb} --help says what it does"


def test_every_server_registers_a_kind_of_its_own_name() -> None:
    for name in registry.names("server"):
        assert registry.find("server", name).name == name


FIND_ALL = "from station import registry; [registry.find(KIND, name) for name in registry.names(KIND)]"
QUICK = {
    **{f"listing {kind}s": FIND_ALL.replace("KIND", repr(kind)) for kind in ("server", "device", "camera")},
    "reading a runbook": "from station.supervision import runbook; runbook.load(runbook.find('g1-sim-motion'))",
    "listing verbs": "from station.cli import main; [main.cli.get_command(None, verb) for verb in main.VERBS]",
}


@pytest.mark.usefixtures("processes")
def test_what_is_quick_loads_nothing_heavy() -> None:
    """One process does all of it, so what one step loads stands beside those after it as well."""
    program = f"""
import json, sys
heavy = {{}}
for what, code in {QUICK}.items():
    exec(code)
    heavy[what] = [name for name in {HEAVY} if name in sys.modules]
print(json.dumps(heavy))
"""
    said = subprocess.run([sys.executable, "-B", "-c", program], capture_output=True, text=True, check=True).stdout
    assert {what: loaded for what, loaded in json.loads(said).items() if loaded} == {}


NUMBERS = ("numpy", "scipy", "pandas", "google.protobuf", "redis")
"""Loaded by what makes vectors: NumPy alone takes longer than all else that `station estop` does."""

RUN = """
import sys
from station.cli import main
for line in sys.argv[1:]:
    sys.argv = ["station", *line.split()]
    try:
        main.main()
    except SystemExit:
        pass
    print("loaded by", line, *sys.modules)
"""


def loaded_by(*lines: str, bus: BusAddress | None = None) -> dict[str, set[str]]:
    """Run command lines one after another in a process that is started cold; return what each of them has loaded, and
    those before it."""
    environment = os.environ | ({} if bus is None else {"STATION_BUS": bus.url})
    done = subprocess.run(
        [sys.executable, "-B", "-c", RUN, *lines], capture_output=True, text=True, check=True, env=environment
    )
    told = [said.removeprefix("loaded by ") for said in done.stdout.splitlines() if said.startswith("loaded by ")]
    return {line: set(said.removeprefix(line).split()) for line, said in zip(lines, told, strict=True)}


@pytest.mark.usefixtures("processes")
def test_the_package_itself_loads_nothing_before_a_name_of_it_is_used() -> None:
    code = "import station, sys; print(*(m for m in sys.modules if m.startswith('station'))); station.open_episode\n"
    code += f"print(*(m for m in {HEAVY} if m in sys.modules), dir(station))"
    run = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True, check=True)
    before, after = run.stdout.splitlines()
    assert before == "station"
    assert after.startswith("[")  # none of the heavy ones before it
    assert "'open_episode'" in after


@pytest.mark.usefixtures("processes")
def test_help_of_all_verbs_imports_none_of_them() -> None:
    loaded = loaded_by("--help")["--help"]
    assert not [verb for verb in VERBS if module_of(verb) in loaded]
    assert not loaded & {*HEAVY, *NUMBERS, "msgspec", "rich.console", "ssl", "yaml", "importlib.metadata"}


def test_verbs_that_are_to_answer_at_once_load_no_numpy(bus_server: BusAddress) -> None:
    lines = ("estop", "estop --reset", "status", "bus info", "episodes list", "record --help", "arm --help",
             "disarm --help", "kassow --help", "doctor --help", "completion --help", "up --help")  # fmt: skip
    for line, loaded in loaded_by(*lines, bus=bus_server).items():
        assert not loaded & {*HEAVY, *NUMBERS}, f"station {line}"
