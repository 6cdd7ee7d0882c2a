"""A server's messages of NatNet 3.0 to 4.1; their layout is that of `adapters.devices.natnet.wire`."""

from __future__ import annotations

import struct
from typing import Any

from numpy.typing import NDArray

from adapters.devices.natnet import wire

TICKS_HZ = 10_000_000
_APPLICATION, _MOTIVE, _END = b"Fake Motive", (3, 1, 0, 0), bytes(4)


def server_info(version: wire.Version, data_port: int, group: str) -> bytes:
    """Return the answer to a client that connects: names, versions, clock, and where frames are sent to."""
    content = wire.SERVER.pack(_APPLICATION, *_MOTIVE, *version, 0, 0, TICKS_HZ)
    numbers = bytes(map(int, group.split("."))) if group else bytes(4)
    return _message(wire.SERVER_INFO, content + struct.pack("<HB", data_port, bool(group)) + numbers)


def descriptions(skeletons: tuple[wire.Skeleton, ...], version: wire.Version) -> bytes:
    """Return a marker set and the skeletons, in a message."""
    found = [(0, b"all\0" + struct.pack("<i", 1) + b"M1\0")]
    found += [(2, _skeleton(skeleton, version)) for skeleton in skeletons]
    content = struct.pack("<i", len(found))
    for kind, data in found:
        length = struct.pack("<i", len(data)) if version >= (4, 1) else b""
        content += struct.pack("<i", kind) + length + data
    return _message(wire.DESCRIPTIONS, content)


def frame(number: int, skeletons: dict[int, NDArray[Any]], time_s: float, version: wire.Version) -> bytes:
    """Return a frame with a marker set, a labelled marker, a force plate and skeletons, of a time [s]."""
    bones = b"".join(struct.pack("<ii", id_, len(rows)) + rows.tobytes() for id_, rows in skeletons.items())
    sections = [
        (1, b"all\0" + struct.pack("<i3f", 1, 0.0, 1.0, 0.0)), (0, b""), (0, b""), (len(skeletons), bones),
        *([(0, b"")] if version >= (4, 1) else []),
        (1, struct.pack("<i3ffhf", 1, 0.0, 1.0, 0.0, 0.01, 2, 0.0)), (1, struct.pack("<iiif", 1, 1, 1, 9.5)), (0, b""),
    ]  # fmt: skip
    content = struct.pack("<i", number)
    for count, data in sections:
        content += struct.pack("<i", count) + (struct.pack("<i", len(data)) if version >= (4, 1) else b"") + data
    ticks = round(time_s * TICKS_HZ)
    content += wire.STAMPS.pack(0, 0, time_s, ticks, ticks + 1, ticks + 2)
    content += bytes(8) if version >= (4, 1) else b""
    return _message(wire.FRAME, content + struct.pack("<h", 0) + _END)


def _skeleton(skeleton: wire.Skeleton, version: wire.Version) -> bytes:
    data = skeleton.name.encode() + b"\0" + struct.pack("<ii", skeleton.id, len(skeleton.bones))
    for bone in skeleton.bones:
        data += bone.name.encode() + b"\0" + struct.pack("<ii3f", bone.id, bone.parent, *bone.offset)
        data += struct.pack("<i3fi", 1, 0.0, 0.1, 0.0, 0) + (b"M1\0" if version >= (4, 0) else b"")
    return data


def _message(id_: int, content: bytes) -> bytes:
    return wire.HEADER.pack(id_, len(content)) + content
