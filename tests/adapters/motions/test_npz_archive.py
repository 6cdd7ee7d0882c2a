"""Numpy archives that are damaged, packed otherwise, or hold what is not unpickled."""

from __future__ import annotations

import io
import random
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from adapters.motions import npz_archive
from station.errors import BadFile
from tests.examples import examples

PATH = Path("a.npz")


def packed(**members: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **members)
    return stream.getvalue()


def test_wanted_members_come_with_the_names_of_all() -> None:
    found, names = npz_archive.read(PATH, packed(one=np.ones(2), two=np.zeros(3)), ["one", "none"], what="motion")
    assert (list(found), names) == (["one"], ["one", "two"])


def test_objects_are_refused_or_left_out_and_never_unpickled() -> None:
    data = packed(one=np.array([{}], dtype=object))
    assert npz_archive.read(PATH, data, ["one"], what="motion", ignored=["one"])[0] == {}
    with pytest.raises(BadFile, match=r"a\.npz: not a readable motion \(Object arrays cannot be loaded"):
        npz_archive.read(PATH, data, ["one"], what="motion")


def test_an_encrypted_archive_is_told_in_one_line() -> None:
    data = bytearray(packed(one=np.ones(2)))
    for at, mark in ((6, b"PK\x03\x04"), (8, b"PK\x01\x02")):
        data[data.index(mark) + at] |= 1
    assert zipfile.ZipFile(io.BytesIO(data)).infolist()[0].flag_bits & 1
    with pytest.raises(BadFile, match="not a readable motion"):
        npz_archive.read(PATH, bytes(data), ["one"], what="motion")


def test_whatever_bytes_are_wrong_it_is_read_or_refused_in_one_line() -> None:
    """Numpy reads the header of an array as Python does: what its parser raises is an error of the file, too."""
    whole, chance, told = packed(one=np.ones(2)), random.Random(1), []
    header = whole.index(b"{'descr'")
    for _ in range(examples(2000)):
        damaged = bytearray(whole)
        for _ in range(chance.choice([1, 2, 8])):
            first, last = chance.choice([(header, header + 80), (0, len(whole))])
            damaged[chance.randrange(first, last)] = chance.choice([0, 32, 39, 40, 123, 125, 255])
        crc = zlib.crc32(damaged[header - 10 : header + 134]).to_bytes(4, "little")
        for at, mark in ((14, b"PK\x03\x04"), (16, b"PK\x01\x02")):
            place = damaged.find(mark)
            if place >= 0:
                damaged[place + at : place + at + 4] = crc
        try:
            npz_archive.read(PATH, bytes(damaged), ["one"], what="motion")
        except BadFile as error:
            told.append(str(error))
    assert len(told) > 50
    assert [line for line in told if not line.startswith("a.npz: ") or "\n" in line] == []
