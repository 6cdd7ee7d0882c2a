"""What stands still while an episode is recorded, and is written once: the optics of cameras, and their mounts.

======================  ==============================  ===========================================================
topic                   message type                    for
======================  ==============================  ===========================================================
``KEY/calibration``     ``foxglove.CameraCalibration``  a camera, or depth, whose server stated its intrinsics
``KEY/tf``              ``foxglove.FrameTransform``     one that stated its mount, where the file has the frame that
                                                        it is fixed to: ``world``, or the root of a robot
======================  ==============================  ===========================================================

The frame of a camera is called as its pictures say, after the camera; its depth is in the same frame.
"""

from __future__ import annotations

from collections.abc import Collection

from station.enrich.siblings import TRANSFORM
from station.episode.reading import frames
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.pictures import camera_of
from station.protobuf import foxglove
from station.protobuf.schema import Schema

CALIBRATION = "calibration"


def optics_of(reader: EpisodeReader, known: Collection[str]) -> dict[str, tuple[Schema, bytes] | str]:
    """Return schema and message of each topic, or why there is none.

    Args:
        reader: The episode.
        known: Frames that the file has.
    """
    (found, why_not), depths = frames.optics(reader), frames.depths(reader).values()
    made: dict[str, tuple[Schema, bytes] | str] = {f"{key}/{CALIBRATION}": why for key, why in why_not.items()}
    for key, (inner, mount) in found.items():
        camera, at_ns = camera_of(key), reader.start_ns
        if inner is not None:
            made[f"{key}/{CALIBRATION}"] = (
                foxglove.schema(foxglove.CAMERA_CALIBRATION), foxglove.camera_calibration(inner, at_ns, camera)
            )  # fmt: skip
        if mount is None or key in depths:
            continue  # the frame of depth is that of its camera
        if mount.parent in known:
            values = [*mount.position_m, *mount.quat_wxyz]
            transform = foxglove.transform(values, at_ns, mount.parent, camera)
            made[f"{key}/{TRANSFORM}"] = foxglove.schema(foxglove.FRAME_TRANSFORM), transform
        else:
            made[f"{key}/{TRANSFORM}"] = f"it is fixed to {mount.parent}, a frame that the signals do not give"
    return made
