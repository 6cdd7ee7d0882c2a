"""Imports point one way (docs/architecture.md); what is heavy is imported where it is used; a key is spelled once."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from station import registry
from station.bus import keys
from station.cli.main import VERBS, module_of

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
OUTER = ("servers", "adapters", "bridges")
HEAVY = (
    "av", "dynamixel_sdk", "grpc", "hid", "hidraw", "matplotlib", "mink", "mujoco", "onnxruntime", "pooch",
    "pygame", "rerun", "serial", "simplejpeg", "station_kord", "torch", "xrobotoolkit_sdk", "zmq",
)  # fmt: skip

WHAT_ADAPTERS_NEED = {
    "station.arms", "station.assets", "station.blends", "station.bus.arm_contracts", "station.bus.codec",
    "station.bus.contracts", "station.bus.joints", "station.bus.keys", "station.bus.sample", "station.camera.source",
    "station.config", "station.errors", "station.foreign.kind", "station.operator.deadman", "station.operator.deltas",
    "station.operator.device", "station.operator.driver", "station.operator.measure", "station.operator.reading",
    "station.operator.script_time", "station.operator.voice", "station.protocols", "station.registry",
    "station.rotations", "station.window",
}  # fmt: skip
"""Facts, formats and how to find things: no connection, no loop, no process, no episode."""

WHAT_EXPORTS_NEED = {
    "station.episode.reading.frames", "station.episode.reading.messages", "station.episode.reading.reader",
    "station.episode.reading.vectors", "station.episode.storage.folder", "station.episode.storage.manifest",
    "station.export.columns", "station.export.kind", "station.export.parts", "station.export.resample",
    "station.export.shards", "station.export.tracks", "station.export.verdict",
    "station.software",
}  # fmt: skip
"""What reads an episode, and what every export shares; for `adapters/exports` alone."""

MAY_IMPORT = {
    "assets": set[str](),
    "bus": set[str](),
    "life": {"bus"},
    "control": {"assets", "bus", "life"},
    "motion": {"bus", "life"},
    "protobuf": {"life"},
    "camera": {"bus", "life"},
    "episode": {"assets", "bus", "control", "life", "protobuf"},
    "operator": {"bus", "control", "episode", "life"},
    "supervision": {"assets", "bus", "episode", "life"},
    "suite": {"assets", "bus", "control", "motion", "rehearse"},
    "enrich": {"bus", "episode", "life", "protobuf"},
    "export": {"bus", "episode"},
    "foreign": {"bus", "episode"},
    "view": {"assets", "bus", "control", "episode", "life"},
    "report": {"bus", "episode", "view"},
}
"""What each room of `station` may use of the others, each only of those above it here; `cli` uses them all."""

ROOMS_OF_AN_EPISODE = {
    "storage": set[str](),
    "writing": {"storage"},
    "reading": {"storage"},
    "recorder": {"storage", "writing"},
    "quality": {"storage", "reading"},
    "replaying": {"storage", "reading"},
}
"""What each room of `station/episode` may use of the others."""

NO_VERBS = {
    "__init__", "calibrate_operator", "face", "fields", "keyboard", "main", "options", "quality", "stop_key", "tables",
}  # fmt: skip
"""Modules of `station.cli` that verbs share."""

A_KEY = re.compile(
    r"(action_(body|hand|neck|mimic|joints)|state_(body|hand|neck|joints|tcp|counters|controller)|robot_state|policy_(obs|action|timing)|target|sim_qpos"
    r"|command_(gate|used|source))_(?=$|\{|g1|unitree|kassow)"
    r"|^operator_(status|controls|head|left|right|body_(pos|quat)|hand_(left|right)|twist|joints)_(?=$|\{)"
    r"|^camera_image_(?=$|\{)"
    r"|^station:\S|^t_(action|state)$|^controller_data$"
    r"|^motion_(start|exit)_signal$|" + keys.TWIST2_ROBOT
)
NO_KEYS = {("station/episode/storage/layout.py", "station:recorder:stamps")}
"""A topic of a file, which no bus ever sees."""


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def imports(path: Path) -> Iterator[str]:
    """Yield the full names of the modules that a file imports, at its top or within a function."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports by full name"
            assert node.module is not None
            for name in node.names:
                full = f"{node.module}.{name.name}"
                yield full if is_module(full) else node.module


def is_module(name: str) -> bool:
    path = ROOT / name.replace(".", "/")
    return path.is_dir() or path.with_suffix(".py").is_file()


def ours(path: Path) -> set[str]:
    return {name for name in imports(path) if name.split(".")[0] in ("station", *OUTER)}


def within(names: set[str], *packages: str) -> set[str]:
    return {name for name in names if any(name == package or name.startswith(package + ".") for package in packages)}


def told(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", sources("station"), ids=told)
def test_the_station_imports_no_server_adapter_or_bridge(path: Path) -> None:
    assert not within(ours(path), *OUTER)


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_of_the_station_uses_only_what_architecture_says(room: str) -> None:
    used = {name.split(".")[1] for path in sources(f"station/{room}") for name in within(ours(path), "station")}
    assert used & (MAY_IMPORT.keys() | {"cli", "rehearse"}) <= MAY_IMPORT[room] | {room}
    row = re.search(rf"^\| `station/{room}/` \|.*\|([^|]*)\|$", ARCHITECTURE, re.MULTILINE)
    assert row, "docs/architecture.md tells of every room"
    assert set(re.findall(r"`(\w+)`", row[1])) == MAY_IMPORT[room], "and what it may import"


def test_rooms_of_the_station_have_an_order() -> None:
    rooms = {path.name for path in (ROOT / "station").iterdir() if (path / "__init__.py").is_file()}
    assert rooms == MAY_IMPORT.keys() | {"cli"}
    above: set[str] = {"rehearse"}
    for room, below in MAY_IMPORT.items():
        assert below <= above
        above.add(room)


@pytest.mark.parametrize("room", ROOMS_OF_AN_EPISODE)
def test_a_room_of_an_episode_uses_only_those_below_it(room: str) -> None:
    used = {
        name.split(".")[2]
        for path in sources(f"station/episode/{room}")
        for name in within(ours(path), "station.episode")
    }
    assert used <= ROOMS_OF_AN_EPISODE[room] | {room}


@pytest.mark.parametrize("path", sources("adapters"), ids=told)
def test_an_adapter_imports_other_adapters_and_the_pure_part_of_the_station(path: Path) -> None:
    used = ours(path)
    assert not within(used, "servers", "bridges")
    exports = WHAT_EXPORTS_NEED if told(path).startswith("adapters/exports/") else set()
    assert within(used, "station") <= WHAT_ADAPTERS_NEED | exports


@pytest.mark.parametrize("path", sources("servers"), ids=told)
def test_a_server_imports_the_station_and_adapters_and_no_other_server(path: Path) -> None:
    used = ours(path)
    assert not within(used, "servers")
    assert not within(used, "station.cli")


@pytest.mark.parametrize("path", sources("station", "servers", "adapters"), ids=told)
def test_nobody_imports_the_command_line_but_itself(path: Path) -> None:
    inside = told(path).startswith("station/cli/") or told(path) == "station/__main__.py"
    assert inside or not within(ours(path), "station.cli")


@pytest.mark.parametrize("path", sources("station", "servers", "adapters"), ids=told)
def test_only_one_module_spells_the_keys_of_the_bus(path: Path) -> None:
    if told(path) == "station/bus/keys.py":
        return
    spelled = {text for text in strings(path) if A_KEY.search(text) and (told(path), text) not in NO_KEYS}
    assert not spelled


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
        for text in strings(ROOT / "station/bus/keys.py")
        if text not in ("@", "_", keys.TWIST_ROBOT, keys.KASSOW_FAMILY, "kr810")
    ]
    assert spelled
    assert [text for text in spelled if not A_KEY.search(text)] == []


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


@pytest.mark.parametrize(
    "code",
    [
        "from station import registry; [registry.find('server', name) for name in registry.names('server')]",
        "from station import registry; [registry.find('device', name) for name in registry.names('device')]",
        "from station import registry; [registry.find('camera', name) for name in registry.names('camera')]",
        "from station.supervision import runbook; runbook.load(runbook.find('g1-sim-motion'))",
        "from station.cli import main; [main.cli.get_command(None, verb) for verb in main.VERBS]",
    ],
    ids=["listing servers", "listing devices", "listing cameras", "reading a runbook", "listing verbs"],
)
def test_what_is_quick_loads_nothing_heavy(code: str) -> None:
    loaded = subprocess.run(
        [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"], capture_output=True, text=True, check=True
    ).stdout.split()
    assert [name for name in HEAVY if name in loaded] == []


def test_help_of_all_verbs_imports_none_of_them() -> None:
    code = (
        "import sys; from station.cli import main; sys.argv = ['station', '--help']\n"
        "try: main.main()\n"
        "except SystemExit: print(*sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not [verb for verb in VERBS if module_of(verb) in loaded]
