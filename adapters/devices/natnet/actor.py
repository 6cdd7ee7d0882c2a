"""From the bones of one of Motive's skeletons to the 24 joints of a body in our world.

Motive's world has x to the left of who looks along z, and y up; a bone is turned by nothing when the person stands with
arms out, and its offset is then where it is from its parent (OptiTrack's plug-in for Unity builds that pose of them:
``OptitrackSkeletonAnimator.cs``, which also has the names of bones in Motive's three conventions). Whether bones are
streamed in the world or in their parents' frames is a setting of Motive that no message tells; their lengths do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adapters.captures import skeleton_tree
from adapters.captures.captured import bodies
from adapters.captures.geometry import Y_TO_Z_UP
from adapters.captures.joints import PLACES
from adapters.devices.natnet.wire import TRACKED, Skeleton
from adapters.retarget import frames
from station import rotations
from station.errors import BadFile
from station.operator.sample import Body
from station.protocols import Floats

_MEMBER = 0xFFFF  # of a bone's id in a frame; above it is the skeleton's
_FITS_M = 0.05
_UNIT = 0.01  # of a quaternion's length; it is of single precision
_UP = (0.0, 1.0, 0.0)
_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


class NotAPerson(BadFile):
    """These bones do not describe a person; the message says in a line what to change in Motive."""


class Actor:
    """A person as Motive describes one.

    Args:
        skeleton: The description.

    Raises:
        NotAPerson: bones lack, or nobody stands upright in it.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.name = skeleton.name
        place = {bone.id: index for index, bone in enumerate(skeleton.bones)}
        self._ids = np.array([bone.id for bone in skeleton.bones], dtype=np.int64)
        self._parents = [place.get(bone.parent, -1) for bone in skeleton.bones]
        if len(place) != len(skeleton.bones) or any(parent >= index for index, parent in enumerate(self._parents)):
            raise NotAPerson(f"actor {self.name}: bones are not described from the hips outwards, each once")
        self._offsets = np.array([bone.offset for bone in skeleton.bones], dtype=np.float64).reshape(-1, 3)
        names = [bone.name.removeprefix(f"{skeleton.name}_") for bone in skeleton.bones]
        rest = np.zeros_like(self._offsets)
        for index, parent in enumerate(self._parents):
            rest[index] = self._offsets[index] + (rest[parent] if parent >= 0 else 0.0)
        try:
            self._found = skeleton_tree.find(names, self._parents, f"actor {self.name}")
        except BadFile as error:
            raise NotAPerson(str(error)) from None
        up = skeleton_tree.stands(self._found, rest)
        if up is None or tuple(up) != _UP:
            raise NotAPerson(
                f"actor {self.name}: nobody stands along y in its description; set Up Axis to Y in Motive's streaming"
            )
        fits = skeleton_tree.from_rest(self._found, rest, np.tile(np.eye(3), (len(rest), 1, 1)), up)
        self._fits = fits | {"head": fits["chest"]}
        self._turned = self._found.turns | {"head": self._found.places["head"]}
        self._needed = self._with_parents()
        self._inner = np.flatnonzero(np.array(self._parents) >= 0)

    def body(self, bones: NDArray[np.void]) -> Body | None:
        """Return the body; None where a bone that it needs is not there or not tracked.

        Args:
            bones: Of a frame, dtype `adapters.devices.natnet.wire.BONE`.

        Raises:
            NotAPerson: orientations are none, or lengths fit the description neither way.
        """
        rows = self._in_order(bones)
        if rows is None or not (rows["flags"][self._needed] & TRACKED).all():
            return None
        quats = frames.wxyz(rows["quat_xyzw"])
        is_turn = np.abs(np.linalg.norm(quats, axis=-1) - 1.0) < _UNIT
        if not is_turn[self._needed].all():
            raise NotAPerson(f"actor {self.name}: an orientation is not of unit length")
        quats = np.where(is_turn[:, None], quats, _LEVEL)  # a finger's, of which nothing is asked
        turns = np.stack([rotations.rotate(rotations.normalized(quats), axis) for axis in np.eye(3)], axis=-1)
        at, turns = self._in_world(rows["position"].astype(np.float64), turns)
        places = {name: (at[self._found.places[name]] @ Y_TO_Z_UP.T)[None] for name in PLACES}
        parts = {name: (Y_TO_Z_UP @ turns[self._turned[name]] @ fit)[None] for name, fit in self._fits.items()}
        positions, orientations = bodies(places, parts)
        return Body(positions[0], orientations[0])

    def _in_order(self, bones: NDArray[np.void]) -> NDArray[np.void] | None:
        """Return the bones as described; None where one lacks."""
        ids = bones["id"] & _MEMBER
        if np.array_equal(ids, self._ids):
            return bones
        order = {int(id_): index for index, id_ in enumerate(ids)}
        if any(int(id_) not in order for id_ in self._ids):
            return None
        return bones[[order[int(id_)] for id_ in self._ids]]

    def _in_world(self, at: Floats, turns: Floats) -> tuple[Floats, Floats]:
        """Return places and orientations in Motive's world, in whichever way they are streamed."""
        offsets, parents = self._offsets[self._inner], np.array(self._parents)[self._inner]
        if np.median(np.linalg.norm(at[self._inner] - offsets, axis=1)) > _FITS_M:
            lengths = np.linalg.norm(at[self._inner] - at[parents], axis=1)
            if np.median(np.abs(lengths - np.linalg.norm(offsets, axis=1))) > _FITS_M:
                raise NotAPerson(f"actor {self.name}: bones are not as long as described; is Motive's unit metres?")
            return at, turns
        at, turns = at.copy(), turns.copy()
        for index in self._inner:
            parent = self._parents[index]
            at[index] = at[parent] + turns[parent] @ at[index]
            turns[index] = turns[parent] @ turns[index]
        return at, turns

    def _with_parents(self) -> NDArray[np.int64]:
        needed: set[int] = set()
        for start in (*self._found.places.values(), *self._found.turns.values()):
            index = start
            while index >= 0:
                needed.add(index)
                index = self._parents[index]
        return np.array(sorted(needed))
