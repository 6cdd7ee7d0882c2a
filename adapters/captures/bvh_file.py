"""The format BVH (Biovision): text, a tree of joints with their offsets, then a line of numbers per frame.

``HIERARCHY`` nests ``ROOT`` and ``JOINT`` blocks, each with an ``OFFSET`` from its parent and its ``CHANNELS`` in any
order; ``End Site`` blocks end the branches. ``MOTION`` holds ``Frames:``, ``Frame Time:`` [s] and the numbers of all
channels, in the order of the tree. Rotations are degrees; the first that is listed turns last, so a joint's rotation in
its parent is the product of its channels from left to right. Position channels take the place of the offset, as in the
programs that write them. Neither unit nor axes are said.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adapters.captures.joints import MOST_FRAMES
from adapters.motions import raw
from adapters.robots.g1.kinematics import about
from station.errors import BadFile
from station.protocols import Floats

MOST_JOINTS = 500
"""A body with all its fingers and face has about 150."""

MOST_BYTES, MOST_POSES = 1 << 27, 20_000_000
"""Of a file, and joints times frames: half an hour at 120 Hz of a body with fingers."""

_POSITIONS = ("Xposition", "Yposition", "Zposition")
_ROTATIONS = ("Xrotation", "Yrotation", "Zrotation")
_CHANNELS = {name.lower(): name for name in (*_POSITIONS, *_ROTATIONS)}
_SHOWN = 40


@dataclass(slots=True)
class Node:
    """A joint, or the end of a branch.

    Attributes:
        name: As in the file; that of its parent with ``_end`` for the end of a branch.
        parent: Its place in `Bvh.nodes`; -1 for the root.
        offset: From the parent at rest, in the file's unit.
        channels: As in ``Xrotation``, in the file's order.
    """

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """A file.

    Attributes:
        path: The file.
        nodes: Parents before children.
        frame_s: Time from frame to frame [s].
        values: All channels of each frame, shape (n, channels); rotations in degrees.
    """

    path: Path
    nodes: tuple[Node, ...]
    frame_s: float
    values: Floats

    def poses(self) -> tuple[Floats, Floats]:
        """Return where the nodes are, shape (nodes, n, 3), and their rotations, shape (nodes, n, 3, 3)."""
        return _poses(self.nodes, self.values)

    def rest(self) -> tuple[Floats, Floats]:
        """Return the same of the pose in which all rotations are zero, as one frame; the root at its offset."""
        columns = [
            list(node.offset)["XYZ".index(name[0])] if name in _POSITIONS else 0.0
            for node in self.nodes
            for name in node.channels
        ]
        return _poses(self.nodes, np.array([columns]))


def load(path: Path) -> Bvh:
    """Read a file.

    Raises:
        BadFile: missing, too large, or no BVH.
    """
    data = raw.read_bytes(path)
    if len(data) > MOST_BYTES:
        raise BadFile(
            f"{path}: {len(data) / 1e6:.0f} MB; a BVH file has at most {MOST_BYTES / 1e6:.0f} MB; cut it in two"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadFile(f"{path}: byte {error.start} is no text; expected a BVH file") from None
    head, found, motion = text.partition("MOTION")
    if not found or head.split(maxsplit=1)[:1] != ["HIERARCHY"]:
        raise BadFile(f"{path}: no BVH file: expected HIERARCHY and MOTION, came {_shown(text[:_SHOWN])}")
    nodes = _tree(path, head.split()[1:])
    frame_s, values = _motion(path, motion, sum(len(node.channels) for node in nodes))
    if len(values) * len(nodes) > MOST_POSES:
        raise BadFile(f"{path}: {len(values)} frames of {len(nodes)} joints; cut it in two")
    return Bvh(path, nodes, frame_s, values)


def _tree(path: Path, words: list[str]) -> tuple[Node, ...]:
    """Read the tree; without recursion, because a file may nest as deep as it likes."""
    nodes: list[Node] = []
    open_nodes: list[int] = []
    stream = iter(words)
    for word in stream:
        parent = open_nodes[-1] if open_nodes else -1
        if word == "}":
            if not open_nodes:
                raise BadFile(f"{path}: a bracket closes that none opened; is the file whole?")
            open_nodes.pop()
        elif word in ("ROOT", "JOINT", "End"):
            _expect_place(path, word, nodes, parent)
            name = _until_bracket(path, stream)
            nodes.append(Node(f"{nodes[parent].name}_end" if word == "End" else name, parent))
            open_nodes.append(len(nodes) - 1)
        elif word == "OFFSET" and open_nodes:
            x, y, z = (_number(path, each) for each in _taken(path, stream, 3))
            nodes[parent].offset = (x, y, z)
        elif word == "CHANNELS" and open_nodes:
            nodes[parent].channels = _channels(path, nodes[parent].name, stream)
        else:
            raise BadFile(f"{path}: {_shown(word)} in the hierarchy; expected JOINT, End Site, OFFSET or CHANNELS")
    if open_nodes or not nodes:
        raise BadFile(f"{path}: the hierarchy is not closed; is the file whole?")
    return tuple(nodes)


def _expect_place(path: Path, word: str, nodes: list[Node], parent: int) -> None:
    if len(nodes) >= MOST_JOINTS:
        raise BadFile(f"{path}: more than {MOST_JOINTS} joints; expected those of one person")
    if (word == "ROOT") != (parent < 0) or (word == "ROOT" and nodes):
        raise BadFile(f"{path}: {word} in a wrong place; expected one ROOT that holds all joints of one person")


def _until_bracket(path: Path, stream: Iterator[str]) -> str:
    words: list[str] = []
    for word in stream:
        if word == "{":
            return " ".join(words)
        words.append(word)
        if len(words) > _SHOWN:
            break
    raise BadFile(f"{path}: a joint {_shown(' '.join(words))} without a bracket; is the file whole?")


def _channels(path: Path, joint: str, stream: Iterator[str]) -> list[str]:
    count = _number(path, _taken(path, stream, 1)[0])
    if count not in range(7):
        raise BadFile(f"{path}: {joint} has {count:g} channels; expected 0 to 6")
    channels = [_CHANNELS.get(word.lower(), "") for word in _taken(path, stream, int(count))]
    if "" in channels or len(set(channels)) != len(channels):
        raise BadFile(f"{path}: channels of {joint}: expected different ones of {', '.join(_CHANNELS.values())}")
    placed = [name for name in channels if name in _POSITIONS]
    if len(placed) not in (0, 3):
        raise BadFile(f"{path}: {joint} has {len(placed)} position channels; expected none or all three")
    return channels


def _motion(path: Path, text: str, width: int) -> tuple[float, Floats]:
    found = re.match(r"\s*Frames:\s*(\d{1,9})\s+Frame\s+Time:\s*(\S+)\s", text + " ")
    if found is None:
        raise BadFile(f"{path}: MOTION begins with {_shown(text.strip()[:_SHOWN])}; expected Frames: and Frame Time:")
    count, frame_s = int(found[1]), _number(path, found[2])
    if not 1 <= count <= MOST_FRAMES or frame_s <= 0.0:
        raise BadFile(f"{path}: {count} frames of {frame_s:g} s; expected 1 to {MOST_FRAMES}, each longer than 0 s")
    words = text[found.end() :].split()
    if len(words) != count * width:
        raise BadFile(
            f"{path}: {len(words)} numbers of motion; {count} frames of {width} channels have {count * width}"
        )
    try:
        values = np.array(words, dtype=np.float64).reshape(count, width)
    except ValueError as error:
        raise BadFile(f"{path}: {' '.join(str(error).split())[:100]}; expected numbers of motion") from None
    if not np.isfinite(values).all():
        frame = int((~np.isfinite(values)).any(axis=1).argmax())
        raise BadFile(f"{path}: a channel of frame {frame} is not finite; expected numbers of motion")
    return frame_s, values


def _poses(nodes: tuple[Node, ...], values: Floats) -> tuple[Floats, Floats]:
    places, turns = np.empty((len(nodes), len(values), 3)), np.empty((len(nodes), len(values), 3, 3))
    column = 0
    for index, node in enumerate(nodes):
        offset, turn = np.tile(node.offset, (len(values), 1)), np.broadcast_to(np.eye(3), (len(values), 3, 3))
        for name in node.channels:
            if name in _POSITIONS:
                offset[:, "XYZ".index(name[0])] = values[:, column]
            else:
                turn = turn @ about(name[0].lower(), np.radians(values[:, column]))
            column += 1
        if node.parent < 0:
            places[index], turns[index] = offset, turn
        else:
            carrier = turns[node.parent]
            places[index] = places[node.parent] + (carrier @ offset[..., None])[..., 0]
            turns[index] = carrier @ turn
    return places, turns


def _taken(path: Path, stream: Iterator[str], count: int) -> list[str]:
    words = list(itertools.islice(stream, count))
    if len(words) != count:
        raise BadFile(f"{path}: the hierarchy ends in the middle of a joint; is the file whole?")
    return words


def _number(path: Path, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadFile(f"{path}: {_shown(word)} where a number is expected")
    return value


def _shown(text: str) -> str:
    return repr(text[:_SHOWN])
