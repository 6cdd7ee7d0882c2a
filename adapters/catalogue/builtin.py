"""What is built in: models of robots, how they stand, a policy that tracks, motions of no file, scripts of fakes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from station.assets import Collection

_ADAPTERS = Path(__file__).parents[1]


def _motions() -> Sequence[str]:
    from adapters.motions import builtin  # with numpy, and how they are made: only for who asks

    return builtin.names()


def _files() -> dict[str, Path]:
    robots = _ADAPTERS / "robots"
    of_robots = [path for name in ("*.xml", "*.stand.yaml", "*.hand.yaml") for path in robots.glob(f"*/{name}")]
    found = [*of_robots, *(_ADAPTERS / "policies").glob("*/*.onnx")]
    scripts = [*(_ADAPTERS / "devices/fakes").glob("*/*.json"), *(_ADAPTERS / "ros2").glob("*.yaml")]
    return {path.name: path for path in sorted(found)} | {
        f"{path.parent.name}/{path.name}": path for path in sorted(scripts)
    }


COLLECTION = Collection(
    about="Part of the program: needs no download.", built_in=_files(), licence="Apache-2.0", motions=_motions
)
