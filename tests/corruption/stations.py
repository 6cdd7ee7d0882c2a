"""Episodes made by real stations, each on a bus of its own: what the bench spoils, and what must be told good."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.cli.running import Home

WITH_CAMERAS = """
runbook: operator-with-cameras
description: a headset drives the G1 in MuJoCo, with pictures of its head and left wrist
robot: unitree_g1_with_hands
steps:
  - check: bus
  - start: g1
    with: {backend: mujoco, robot_model: "builtin:g1.xml", policy: tracker}
    ready_within: 60s
  - start: head
    server: camera
    with: {source: mujoco, width: 320, height: 240, fps: 15, depth: true}
    ready_within: 60s
  - start: left_wrist
    server: camera
    with: {source: mujoco, options: {camera: left_wrist}, width: 320, height: 240, fps: 15}
    ready_within: 60s
  - start: recorder
  - start: pico
  - start: teleop
    with: {device: pico, driver: hands}
    ready_within: 60s
on_failure: [stop: teleop, stop: pico, stop: g1, stop: left_wrist, stop: head, stop: recorder]
"""
"""A lab's own runbook: what ships with cameras has no operator. At 15 Hz a busy machine draws every picture."""

HEADSET = {
    "device": "pico",
    "motion": "builtin:wave",
    "repeat": "swing",
    "controls": [
        {"at_s": 1.0, "press": "right_primary"},
        {"at_s": 3.5, "set": {"left_trigger": 1.0}, "for_s": 2.0},
        {"at_s": 5.0, "set": {"left_stick_y": 0.5}, "for_s": 4.0},
    ],
}
"""Somebody who engages after a second, waves, grasps, and walks."""

HAS_ARMS = importlib.util.find_spec("station_kord") is not None


@dataclass(frozen=True)
class Kind:
    """A station that makes one kind of episode.

    Attributes:
        name, runbook: Its name; a runbook that ships, or the text of one.
        settings: ``server.key=value``.
        others: Settings that make another episode of the same kind.
        seconds: How long it is recorded [s].
        files: Files that settings name as ``{name}``, as JSON.
    """

    name: str
    runbook: str
    settings: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    seconds: float = 11.0
    files: tuple[tuple[str, object], ...] = ()

    def arguments(self, folder: Path, *, other: bool = False) -> list[str]:
        """Return the words that start it; writes what they name into a folder."""
        book = self.runbook
        if "\n" in book:
            (folder / "book.yaml").write_text(book)
            book = str(folder / "book.yaml")
        for name, content in self.files:
            (folder / f"{name}.json").write_text(json.dumps(content))
        given = (*self.settings, *(self.others if other else ()))
        paths = {name: folder / f"{name}.json" for name, _ in self.files}
        sets = [word for setting in given for word in ("--set", setting.format(**paths))]
        return ["up", book, "--yes", "--record", "--task", self.name, "--instruction", f"do {self.name}", *sets]


KINDS = {
    kind.name: kind
    for kind in (
        Kind("walk", "g1-sim-motion", ("motion.motion=builtin:walk-arc",), ("motion.motion=builtin:walk-forward",)),
        Kind(
            "operator", WITH_CAMERAS, ("pico.fake={headset}",), ("pico.fake={another}",), 13.0,
            (("headset", HEADSET), ("another", HEADSET | {"motion": "builtin:reach-both"})),
        ),
        *(
            [
                Kind(
                    "arm", "kassow-sim-spacemouse", ("spacemouse.fake=builtin:spacemouse/arm.json",),
                    ("teleop.driver=arm-joints",), 12.0,
                )
            ]
            if HAS_ARMS
            else []
        ),
    )
}  # fmt: skip
"""What is spoiled."""

_PICO = ("g1-sim-pico", ("pico.fake=builtin:pico/example.json",))
SOUND = [
    Kind("wave", "g1-sim-motion", ("motion.motion=builtin:wave",), seconds=8.0),
    Kind("walk-fast", "g1-sim-motion", ("motion.motion=builtin:walk-fast",), seconds=9.0),
    Kind("gamepad", "g1-sim-gamepad", ("gamepad.fake=builtin:gamepad/example.json",)),
    Kind("cameras", "g1-sim-cameras", seconds=9.0),
    Kind("keyboard", "g1-sim-keyboard", ("keyboard.fake=builtin:keyboard/example.json",)),
    Kind("pico", *_PICO, seconds=14.0),
    Kind("look-around", "g1-sim-motion", ("motion.motion=builtin:look-around",), seconds=8.0),
    Kind("spacemouse", "g1-sim-spacemouse", ("spacemouse.fake=builtin:spacemouse/example.json",)),
    Kind("gello", "g1-sim-gello", ("gello.fake=builtin:gello/g1.json", "gamepad.fake=builtin:gamepad/example.json")),
    Kind("stand", "g1-sim-motion", ("motion.motion=builtin:stand",), seconds=7.0),
    Kind("squat", "g1-sim-cameras", ("motion.motion=builtin:squat",), seconds=9.0),
    KINDS["operator"],
    Kind("turn-left", "g1-sim-motion", ("motion.motion=builtin:turn-left",), seconds=9.0),
]
if HAS_ARMS:
    SOUND[2:2] = [Kind("arm-mouse", "kassow-sim-spacemouse", ("spacemouse.fake=builtin:spacemouse/arm.json",))]
    SOUND[6:6] = [Kind("two-arms", "g1-and-two-arms-sim", seconds=10.0)]
    SOUND[9:9] = [Kind("arm-keys", "kassow-sim-keyboard", ("keyboard.fake=builtin:keyboard/arm.json",))]
    SOUND += [
        Kind(
            "arm-gello", "kassow-sim-gello",
            ("gello.fake=builtin:gello/arm.json", "gamepad.fake=builtin:gamepad/example.json"),
        )
    ]  # fmt: skip
"""What is made beside busy loops, one after the other and again from the first."""


@contextlib.contextmanager
def station_home() -> Iterator[tuple[Home, Path]]:
    """A user's environment with a path that is short enough for a socket, and a folder for files of a station."""
    folder = Path(tempfile.mkdtemp(prefix="stc-"))
    files = folder / "files"
    try:
        home = Home(folder)
        files.mkdir()
        yield home, files
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def record(kind: Kind, into: Path, *, other: bool = False) -> Path:
    """Record an episode and move its folder to `into`.

    Raises:
        RuntimeError: the station ended badly or recorded none; the message is its last words.
    """
    with station_home() as (home, files):
        done = home.run(*kind.arguments(files, other=other), "--for", f"{kind.seconds:g}s")
        return take_episode(home, into, done.stderr)


def take_episode(home: Home, into: Path, words: str) -> Path:
    """Move the only episode of a home to `into`, and return where it is."""
    found = [path.parent for path in home.data.glob("*/*/manifest.yaml")]
    if len(found) != 1:
        raise RuntimeError(f"{len(found)} episodes, expected one; the station said:\n{words[-2000:]}")
    into.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(into, ignore_errors=True)
    shutil.move(found[0], into)
    return into
