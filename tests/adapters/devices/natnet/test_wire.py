"""NatNet's messages: layouts put together by hand from what is published, not by the fake's own writer."""

from __future__ import annotations

import contextlib
import random
import struct

import numpy as np
import pytest

from adapters.devices.fakes.natnet import packets, person
from adapters.devices.natnet import wire
from adapters.retarget.human import of_height, standing
from tests.fuzz.mutants import mutant

OLD, NEW = (3, 0), (4, 1)


def bone(number: int, flags: int = 1) -> bytes:
    """Id, place, orientation x y z w, error, flags: 38 bytes."""
    return struct.pack("<i3f4ffh", 7 << 16 | number, 0.1, 1.0, -0.2, 0.0, 0.0, 0.0, 1.0, 0.001, flags)


def suffix(*, is_new: bool, flags: int = 0) -> bytes:
    precise = struct.pack("<II", 11, 12) if is_new else b""
    return struct.pack("<IIdQQQ", 1, 2, 12.5, 125_000_000, 3, 4) + precise + struct.pack("<h", flags) + bytes(4)


def old_frame(bones: bytes, count: int, flags: int = 0) -> bytes:
    sections = (
        struct.pack("<i", 2) + b"all\0" + struct.pack("<i3f", 1, 1, 2, 3) + b"b\0" + struct.pack("<i", 0)
        + struct.pack("<i3f", 1, 4, 5, 6)  # other markers
        + struct.pack("<i", 1) + bone(1)  # a rigid body
        + struct.pack("<iii", 1, 7, count) + bones
        + struct.pack("<ii3ffhf", 1, 9, 1, 2, 3, 0.01, 2, 0.0)  # a labelled marker
        + struct.pack("<iiiiffif", 1, 1, 2, 2, 0.5, 0.5, 1, 0.5)  # a force plate: channels of two and one
        + struct.pack("<i", 0)
    )  # fmt: skip
    return struct.pack("<i", 99) + sections + suffix(is_new=False, flags=flags)


def new_frame(bones: bytes, count: int) -> bytes:
    def section(elements: int, data: bytes) -> bytes:
        return struct.pack("<ii", elements, len(data)) + data

    asset = struct.pack("<iii", 3, 0, 0)
    skeleton = struct.pack("<ii", 7, count) + bones
    return struct.pack("<i", 99) + b"".join([
        section(1, b"all\0" + struct.pack("<i", 0)), section(0, b""), section(1, bone(1)), section(1, skeleton),
        section(1, asset), section(0, b""), section(0, b""), section(0, b""),
    ]) + suffix(is_new=True)  # fmt: skip


@pytest.mark.parametrize("version", wire.VERSIONS)
def test_a_frame_is_read_at_the_published_places(version: wire.Version) -> None:
    made = new_frame if version >= NEW else old_frame
    found = wire.frame(made(bone(1) + bone(2, flags=0), 2), version)
    rows = found.skeletons[7]
    assert (found.number, found.time_s, found.exposed, found.changed) == (99, 12.5, 125_000_000, False)
    assert (rows["id"] & 0xFFFF).tolist() == [1, 2]
    assert rows["flags"].tolist() == [1, 0]
    np.testing.assert_allclose(rows["position"][1], [0.1, 1.0, -0.2], rtol=1e-6)
    np.testing.assert_array_equal(rows["quat_xyzw"][0], [0.0, 0.0, 0.0, 1.0])


def test_a_frame_says_that_skeletons_have_changed() -> None:
    assert wire.frame(old_frame(bone(1), 1, flags=2), OLD).changed


@pytest.mark.parametrize("version", [OLD, NEW])
def test_a_frame_that_is_cut_anywhere_is_refused(version: wire.Version) -> None:
    whole = (new_frame if version >= NEW else old_frame)(bone(1), 1)
    end = len(whole) - 4  # behind the flags is a word that nobody needs
    for length in range(end):
        with pytest.raises(wire.BadPacket, match=r"announced|name of more"):
            wire.frame(whole[:length], version)
    wire.frame(whole[:end], version)


@pytest.mark.parametrize("version", [OLD, NEW])
@pytest.mark.parametrize("count", [1_000_000, 2**31 - 1, -1])
def test_a_count_beyond_what_came_is_refused_before_anything_is_made_of_it(version: wire.Version, count: int) -> None:
    whole = (new_frame if version >= NEW else old_frame)(bone(1), count)
    with pytest.raises(wire.BadPacket, match=rf"{count} elements announced where \d+ bytes are left"):
        wire.frame(whole, version)


def test_what_is_not_finite_is_refused() -> None:
    nan = bone(1)[:4] + struct.pack("<f", float("nan")) + bone(1)[8:]
    with pytest.raises(wire.BadPacket, match="a bone of skeleton 7 is not finite"):
        wire.frame(old_frame(nan, 1), OLD)


@pytest.mark.parametrize("version", wire.VERSIONS)
def test_skeletons_are_found_among_all_that_is_described(version: wire.Version) -> None:
    names = b"M1\0M2\0" if version >= (4, 0) else b""
    hip = b"Ada_Hip\0" + struct.pack("<ii3f", 1, 0, 0.0, 1.0, 0.0)
    hip += struct.pack("<i3f3fii", 2, *range(6), 8, 9) + names
    leg = b"Ada_LThigh\0" + struct.pack("<ii3f", 2, 1, 0.1, 0.0, 0.0) + struct.pack("<i", 0)
    parts = [
        (0, b"all\0" + struct.pack("<i", 1) + b"M1\0"),
        (1, b"box\0" + struct.pack("<ii3fi", 5, -1, 0, 0, 0, 0)),
        (3, struct.pack("<i", 1) + b"serial\0" + bytes(4 * 163) + struct.pack("<i", 1) + b"Fz\0"),
        (4, struct.pack("<i", 1) + b"daq\0serial\0" + bytes(8) + struct.pack("<i", 1) + b"ch\0"),
        (5, b"camera\0" + bytes(28)),
        (2, b"Ada\0" + struct.pack("<ii", 7, 2) + hip + leg),
    ]
    content = struct.pack("<i", len(parts))
    for kind, data in parts:
        content += struct.pack("<i", kind) + (struct.pack("<i", len(data)) if version >= NEW else b"") + data
    (found,) = wire.descriptions(content, version)
    assert (found.name, found.id) == ("Ada", 7)
    assert [(each.name, each.id, each.parent) for each in found.bones] == [("Ada_Hip", 1, 0), ("Ada_LThigh", 2, 1)]
    assert found.bones[1].offset == pytest.approx((0.1, 0.0, 0.0))
    with pytest.raises(wire.BadPacket):
        wire.descriptions(content[:-1], version)


def test_a_server_says_its_version_and_its_clock() -> None:
    content = (
        b"Motive".ljust(256, b"\0") + bytes([3, 1, 0, 1, 4, 1, 0, 0]) + struct.pack("<QHB4B", 10**7, 1511, 0, *[0] * 4)
    )
    assert wire.server_info(content) == wire.ServerInfo("Motive 3.1", (4, 1), 10**7)
    assert wire.server_info(content[:264]).version == (4, 1), "one before 3.0 has no clock, and is told its version"
    with pytest.raises(wire.BadPacket):
        wire.server_info(content[:200])


def test_a_message_shorter_than_it_says_is_refused() -> None:
    assert wire.opened(struct.pack("<HH", 7, 3) + b"abcd") == (7, b"abc")
    with pytest.raises(wire.BadPacket, match="4 bytes announced where 3 are left"):
        wire.opened(struct.pack("<HH", 7, 4) + b"abc")


@pytest.mark.parametrize("version", wire.VERSIONS)
def test_no_mutant_of_a_packet_raises_anything_else(version: wire.Version) -> None:
    body, rng = standing(of_height(1.7)), random.Random(str(version))
    rows = person.seen(body.positions[None], body.quats_wxyz[None], is_local=True)[0]
    frame = packets.frame(1, {person.ID: rows}, 1.0, version)[4:]
    described = packets.descriptions((person.described(of_height(1.7)),), version)[4:]
    for valid, parse in ((frame, wire.frame), (described, wire.descriptions)):
        for _ in range(300):
            with contextlib.suppress(wire.BadPacket):
                parse(mutant(valid, rng), version)
