"""The kinds of cameras as they are registered: by name, with options; libraries are imported when one is opened."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.camera.source import Camera, CameraKind, Newest, PictureSettings


class UvcOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `uvc`.

    Attributes:
        device: Its file (``/dev/video0``; ``/dev/v4l/by-id/…`` stays the same wherever it is plugged in), or a part of
            its name; "" for the only one.
        serial: Its serial number, where several have the same name.
        format: ``MJPG``, passed on as it comes; ``YUYV``, encoded here; ``auto`` takes the first that fits.
        devices: Folder with the files of the devices.
    """

    device: str = ""
    serial: str = ""
    format: Literal["auto", "MJPG", "YUYV"] = "auto"
    devices: Path = Path("/dev")


class FilesOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `files`.

    Attributes:
        path: A folder of pictures, or a video file.
        loop: Whether it begins again at the end.
    """

    path: Path
    loop: bool = True


class RealSenseOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `realsense`.

    Attributes:
        serial: Its serial number; "" for the only one.
        file: A recording of the RealSense SDK in place of a camera, played in real time, again and again.
    """

    serial: str = ""
    file: Path | None = None


class MujocoOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `mujoco`.

    Attributes:
        camera: Name of the camera in the model: ``head``, of a G1 ``left_wrist`` and ``right_wrist``, too.
        model: MJCF file with the robot, a path or ``collection:path``; "" for the robot's own.
        robot: Suffix of the robot's keys.
        detail: ``fine`` draws shadows and smooth edges, which takes a graphics card.
    """

    camera: str = "head"
    model: str = ""
    robot: str = twist_keys.TWIST2_ROBOT
    detail: Literal["plain", "fine"] = "plain"


class ZmqOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the source `zmq`.

    Attributes:
        address: Where the sender is: the robot's, in TWIST2.
    """

    address: str = "tcp://192.168.123.164:5555"


def _plugged_in() -> Sequence[str]:
    from adapters.cameras import v4l2

    return [str(camera) for camera in v4l2.found()]


def _uvc(options: UvcOptions, settings: PictureSettings, _newest: Newest) -> Camera:
    from adapters.cameras.uvc import UvcCamera

    return UvcCamera(options.device, options.serial, options.format, settings, devices=options.devices)


def _files(options: FilesOptions, settings: PictureSettings, _newest: Newest) -> Camera:
    from adapters.cameras.files import FilesCamera

    return FilesCamera(options.path, settings, is_looped=options.loop)


def _realsense(options: RealSenseOptions, settings: PictureSettings, _newest: Newest) -> Camera:
    from adapters.cameras.realsense import RealSenseCamera

    return RealSenseCamera(options.serial, options.file, settings)


def _realsenses() -> Sequence[str]:
    from adapters.cameras import realsense
    from adapters.cameras.encode import library

    sdk = library("pyrealsense2", "pyrealsense2", "the source realsense", extra="realsense")
    return [f"{name}, serial {serial}" for serial, name in realsense.plugged_in(sdk).items()]


def _mujoco(options: MujocoOptions, settings: PictureSettings, newest: Newest) -> Camera:
    from adapters.cameras.mujoco_robot import MujocoCamera
    from adapters.robots.legged.unitree import G1, ROBOTS

    robot = ROBOTS.get(options.robot, G1)  # a G1's keys have several names
    return MujocoCamera(
        options.model or robot.mjcf, options.camera, keys.sim_qpos(options.robot), settings, newest,
        is_fine=options.detail == "fine", robot=robot,
    )  # fmt: skip


def _zmq(options: ZmqOptions, settings: PictureSettings, _newest: Newest) -> Camera:
    from adapters.cameras.zmq_stream import ZmqCamera

    return ZmqCamera(options.address, settings)


UVC = CameraKind(
    name="uvc",
    about="USB camera through Video4Linux: MJPG as it comes, or YUYV",
    library="",
    extra="",
    options=UvcOptions,
    open=_uvc,
    plugged_in=_plugged_in,
)
FILES = CameraKind(
    name="files",
    about="a folder of pictures, or a video file, in real time",
    library="av",
    extra="video",
    options=FilesOptions,
    open=_files,
)
MUJOCO = CameraKind(
    name="mujoco",
    about="what head or wrist cameras of a simulated G1 see, and how far it is (depth)",
    library="simplejpeg",
    extra="video",
    has_depth=True,
    options=MujocoOptions,
    open=_mujoco,
    keys=lambda options: (keys.sim_qpos(options.robot),),
)
ZMQ = CameraKind(
    name="zmq",
    about="the picture stream of TWIST2's robot",
    library="pyzmq",
    extra="video",
    options=ZmqOptions,
    open=_zmq,
)
REALSENSE = CameraKind(
    name="realsense",
    about="colour and depth of an Intel RealSense, with the factory's intrinsics",
    has_depth=True,
    library="pyrealsense2",
    extra="realsense",
    options=RealSenseOptions,
    open=_realsense,
    plugged_in=_realsenses,
)
