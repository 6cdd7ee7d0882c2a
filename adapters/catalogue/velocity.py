"""Scripts of velocities that are built in, for any robot on legs."""

from __future__ import annotations

from collections.abc import Sequence

from station.assets import Collection


def _motions() -> Sequence[str]:
    from adapters.motions import velocities  # with numpy: only for who asks

    return velocities.names()


COLLECTION = Collection(
    about="Part of the program: scripts of velocities for robots on legs.", licence="Apache-2.0", motions=_motions
)
