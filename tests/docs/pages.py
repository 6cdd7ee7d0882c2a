"""Which pages are typed, what has to be there before, and which commands of them are typed otherwise."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adapters.robots.g1.joints import G1_29
from station import assets
from tests.adapters.captures.people import moving
from tests.adapters.captures.written import write_amass, write_bvh
from tests.docs.reader import Typed
from tests.foreign.recorded import document, record
from tests.main_job.page_package import install
from tests.tiers import ROOT

_INSTALLS = Typed(elsewhere="tests/test_wheel.py and `make` install; a page's package: its `prepare`")
_DRIVEN_FOR = "--yes --for 8s --set"
_STOCK = f"cd {ROOT} && python -m tests.stock.stock_twist2"


class Page(NamedTuple):
    """How a page is typed.

    Attributes:
        how: Commands that are not simply typed, by how they begin.
        prepare: Puts what the page takes for granted into the folder of its reader.
        has_upstream_data: Whether its reader has it.
        inside: The folder below his own that its reader is in.
    """

    how: Mapping[str, Typed] = {}
    prepare: Callable[[Path], None] = lambda folder: None
    has_upstream_data: bool = True
    inside: str = ""


def _motions(folder: Path) -> None:
    """A stand of two seconds, as two kinds of file, and the dance that the page's reader has downloaded."""
    still = np.ones((100, 1))
    root_pos, root_quat, joint_pos = still * [0.0, 0.0, 0.78], still * [1.0, 0.0, 0.0, 0.0], still * np.zeros(29)
    values = {"root_pos": root_pos, "root_quat_wxyz": root_quat, "joint_pos": joint_pos}
    np.savez(folder / "mine.npz", fps=50.0, joint_names=G1_29, **values)
    (folder / "clips").mkdir()
    rows = np.hstack([root_pos, np.roll(root_quat, -1, axis=1), joint_pos])
    np.savetxt(folder / "clips" / "stand.csv", rows, delimiter=",")
    dance = "ppo_g1_29dof_dancing.onnx"
    shutil.copy(assets.resolve(f"zoo:policies/holosoma_wbt_{dance}"), folder / dance)


def _captures(folder: Path) -> None:
    """Three seconds of a walk, as BVH and as AMASS."""
    person = moving("walk-forward", 3.0, 0.0)
    write_bvh(folder / "walk.bvh", person)
    (folder / "amass").mkdir()
    write_amass(folder / "amass" / "walk_poses.npz", person)


def _recordings(folder: Path) -> None:
    """A recording of TWIST2's recorder."""
    record(folder / "RECORDINGS" / "cabinet" / "episode_0000", document(40))


def _limits(folder: Path) -> None:
    """The data sheet of another arm: here that of the one that ships, under its name."""
    limits = (ROOT / "adapters/robots/kassow/kr810.yaml").read_text(encoding="utf-8")
    (folder / "kr1018.yaml").write_text(limits.replace("model: kr810", "model: kr1018"), encoding="utf-8")


def _config(folder: Path) -> None:
    (folder / ".config").mkdir()


def _arm_lab(folder: Path) -> None:
    install("your-arm.md", "arm-lab", folder)


def _quad_lab(folder: Path) -> None:
    install("your-robot.md", "quad-lab", folder)


def _pedal_lab(folder: Path) -> None:
    _quad_lab(folder)
    install("your-device.md", "pedal-lab", folder)


def _holosoma_walk(folder: Path) -> None:
    """The package of the page, and the checkpoint that its reader has downloaded."""
    install("your-policy.md", "holosoma-walk", folder)
    _holosoma(folder)


def _holosoma(folder: Path) -> None:
    """The checkpoints that the page's reader has downloaded."""
    shutil.copy(assets.resolve("zoo:policies/holosoma_fastsac_g1_29dof.onnx"), folder / "fastsac_g1_29dof.onnx")
    shutil.copy(assets.resolve("zoo:policies/falcon_g1_29dof.onnx"), folder / "g1_29dof.onnx")


PAGES = {
    "README.md": Page({
        "make demo": Typed(elsewhere="docs/first-episode.md"),
        "make test": Typed(elsewhere="what runs this"),
        "station up g1-sim-gamepad": Typed(
            instead="station up g1-sim-gamepad --record --task walk"
            f" {_DRIVEN_FOR} gamepad.fake=builtin:gamepad/example.json"
        ),
        "station status --watch": Typed(until="waiting for it"),
        "station view latest": Typed(code=1),
        "station doctor": Typed(code=1),
    }),
    "docs/first-episode.md": Page({
        "git clone": Typed(elsewhere="a clone is what this runs in"),
        "make demo": Typed(
            instead=f"PATH={os.defpath} make --no-print-directory -C {ROOT} demo"
        ),
        "station up g1-demo --yes": Typed(until="to=tracking"),
        "station check": Typed(behind="station up g1-demo --yes"),
        "station bus start": Typed(until="Ctrl-C stops it"),
        "station serve g1": Typed(until="active on"),
        "station serve recorder": Typed(until="active on"),
    }, has_upstream_data=False),
    "docs/files-and-versions.md": Page(has_upstream_data=False),
    "docs/gallery.md": Page(has_upstream_data=False),
    "docs/motions.md": Page({"pip": _INSTALLS, "unzip": Typed(elsewhere="of a download")}, _motions),
    "docs/robots.md": Page({
        "station bus start": Typed(until="Ctrl-C stops it"),
        "station serve robot": Typed(until="active on"),
    }, has_upstream_data=False),
    "docs/captures.md": Page({"pip install": _INSTALLS}, _captures),
    "docs/operators.md": Page({
        "pip install": _INSTALLS,
        "station up g1-sim-pico --record": Typed(elsewhere="the next one, by a fake"),
        "station up g1-sim-mocap --record": Typed(elsewhere="the next one, by a fake"),
    }),
    "docs/lidar.md": Page({
        "pip install": _INSTALLS,
        "station bus start": Typed(until="Ctrl-C stops it"),
        "station serve lidar": Typed(until="active on"),
        "python -m adapters.lidars.dds_room": Typed(elsewhere="tests/servers/test_proof_lidar.py"),
    }, has_upstream_data=False),
    "docs/console.md": Page({
        "pip install": _INSTALLS,
        "station console": Typed(elsewhere="tests/web/test_console.py, beside a bus"),
        "station up": Typed(elsewhere="tests/web/test_page.py, seen by a browser"),
    }, has_upstream_data=False),
    "docs/webxr.md": Page({
        "pip install": _INSTALLS,
        "station up g1-sim-webxr --record": Typed(elsewhere="the next one, by a fake"),
        "station pair": Typed(elsewhere="tests/web/test_console.py, beside a page"),
    }, has_upstream_data=False),
    "docs/foxglove.md": Page({
        "pip install": _INSTALLS,
        "station serve foxglove": Typed(elsewhere="tests/servers/test_foxglove.py, beside a bus"),
    }, has_upstream_data=False),
    "docs/lcm.md": Page({
        "station up": Typed(elsewhere="tests/main_job/test_lcm.py"),
    }, has_upstream_data=False),
    "docs/zmq.md": Page({
        "pip install": _INSTALLS,
        "station up": Typed(elsewhere="tests/main_job/test_sonic.py"),
        "station serve picture-stream": Typed(elsewhere="tests/servers/test_picture_stream.py, on an address of here"),
    }, has_upstream_data=False),
    "docs/zenoh.md": Page({
        "pip install": _INSTALLS,
        "station serve zenoh": Typed(elsewhere="tests/servers/test_zenoh.py, beside a bus"),
    }, has_upstream_data=False),
    "docs/ros2.md": Page({
        "pip install": _INSTALLS,
        "station up": Typed(elsewhere="tests/main_job/test_proof_ros2.py"),
        "ros2 topic": Typed(elsewhere="in a shell with ROS"),
    }, has_upstream_data=False),
    "docs/kassow.md": Page({
        "pip install": _INSTALLS,
        "station up kassow-sim-spacemouse --set": Typed(
            instead="station up kassow-sim-spacemouse --set kassow.model=kr1018 --set kassow.limits=kr1018.yaml"
            " --set teleop.driver=arm-joints --set teleop.options.model=kr1018 --set teleop.options.limits=kr1018.yaml"
            f" {_DRIVEN_FOR} spacemouse.fake=builtin:spacemouse/arm.json"
        ),
        "station kassow controller": Typed(elsewhere="tests/faults/test_kassow.py"),
        "station serve kassow": Typed(elsewhere="tests/faults/test_kassow.py"),
    }, _limits),
    "docs/g1-real.md": Page({
        "pip install": _INSTALLS,
        "station up g1-twin-motion --yes --record": Typed(elsewhere="tests/main_job/test_real_g1.py"),
        "station up g1-twin-gantry": Typed(elsewhere="tests/main_job/test_proof_gantry.py"),
        "station check": Typed(elsewhere="tests/main_job/test_real_g1.py"),
        "station robot-twin g1 state_silent": Typed(elsewhere="tests/servers/test_robot_twin.py, beside one that runs"),
        "station robot-twin g1 --well": Typed(elsewhere="tests/servers/test_robot_twin.py, beside one that runs"),
        "station doctor": Typed(elsewhere="beside a robot"),
        "make -C bridges": Typed(elsewhere="tests/bridges/g1_guard/test_build.py"),
        "bridges/g1_guard": Typed(elsewhere="tests/bridges/g1_guard/test_station.py"),
        "station up g1-twin-motion --yes --set": Typed(elsewhere="tests/bridges/g1_guard/test_station.py"),
    }, has_upstream_data=False),
    "docs/runbooks.md": Page({
        "station up g1-sim-motion.yaml": Typed(instead="station up ./g1-sim-motion.yaml --yes --for 5s"),
    }),
    "docs/security.md": Page({
        "station bus start": Typed(instead="station bus start --bind 127.0.0.1", until="stock scripts"),
    }, _config),
    "docs/stock-scripts.md": Page({
        "station bus start": Typed(until="Ctrl-C stops it"),
        "station up g1-for-stock": Typed(until="recording"),
        "python -m tests.stock.stock_twist2 motion": Typed(instead=f"{_STOCK} motion --port 6379 --seconds 12"),
        "station check": Typed(behind="station up g1-for-stock"),
        "station serve motion": Typed(until="active on"),
        "python -m tests.stock.stock_twist2 robot": Typed(instead=f"{_STOCK} robot --port 6379 --seconds 6"),
        "python -m tests.stock.stock_twist2 recorder": Typed(instead=f"{_STOCK} recorder --port 6379 --seconds 1"),
    }),
    "docs/training-data.md": Page(prepare=_recordings),
    "docs/ros2-bags.md": Page({
        "pip install": _INSTALLS,
    }, has_upstream_data=False),
    "docs/assets.md": Page(has_upstream_data=False),
    "docs/your-arm.md": Page({
        "pip install": _INSTALLS,
        "station up arm6": Typed(instead="station up arm6.yaml --record --task wave"
                                 f" {_DRIVEN_FOR} gamepad.fake=builtin:gamepad/example.json"),
    }, _arm_lab, inside="arm-lab"),
    "docs/your-device.md": Page({
        "pip install": _INSTALLS,
        "station devices fake pedals": Typed(until="pedal_left"),
        "station serve pedals": Typed(elsewhere="needs the pedals; without them: tests/main_job/test_your_device.py"),
    }, _pedal_lab, inside="pedal-lab"),
    "docs/your-policy.md": Page({
        "pip": _INSTALLS, "unzip": Typed(elsewhere="of a download"),
    }, _holosoma_walk),
    "docs/velocity.md": Page({
        "pip": _INSTALLS, "unzip": Typed(elsewhere="of a download"),
        "station up g1-velocity-gamepad": Typed(
            instead="station up g1-velocity-gamepad --record --task walk"
            f" {_DRIVEN_FOR} gamepad.fake=builtin:gamepad/example.json"
        ),
        "station up g1-velocity-keyboard": Typed(
            instead="station up g1-velocity-keyboard --record --task walk"
            f" {_DRIVEN_FOR} keyboard.fake=builtin:keyboard/example.json"
        ),
        "station up go2-sim-gamepad": Typed(
            instead="station up go2-sim-gamepad --record --task walk"
            f" {_DRIVEN_FOR} gamepad.fake=builtin:gamepad/example.json"
        ),
        "station serve motion": Typed(elsewhere="tests/main_job/test_velocity.py, in a runbook"),
        "station up g1-walk-track-pico": Typed(elsewhere="tests/main_job/test_proof_walk_track.py"),
        "station up g1-homie-sim --record --set robot.policy_options.legs=g1-walk": Typed(
            instead="station up g1-homie-sim --record --task carry --set robot.policy_options.legs=g1-walk"
            " --set legs.options.format=velocity --set robot.checkpoint=builtin:g1-walk.onnx"
            " --set left_leader.fake=builtin:gello/g1.json --set right_leader.fake=builtin:gello/g1-right.json"
            f" {_DRIVEN_FOR} gamepad.fake=builtin:gamepad/example.json"
        ),
        "station up g1-cockpit-sim": Typed(elsewhere="tests/main_job/test_parts.py"),
        "station up g1-homie-sim --record": Typed(elsewhere="needs a file that cannot be had here"),
    }, _holosoma),
    "docs/your-robot.md": Page({
        "pip install": _INSTALLS,
        "station bus start": Typed(until="Ctrl-C stops it"),
        "station serve robot": Typed(until="active on"),
    }, _quad_lab, inside="quad-lab"),
}  # fmt: skip

PLAYED_BY = {
    "docs/hosts.md": "tests/main_job/test_hosts_page.py",
    "docs/notebook.md": "tests/api/test_notebook_page.py",
}
"""Pages whose commands need more than a folder, and the tests that play them."""
