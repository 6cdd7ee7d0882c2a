"""Which array of a file holds which numbers of a row, and what they are called."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from adapters.exports.hdf5.plan import Plan
from adapters.exports.lerobot.plan import Camera
from station.export.columns import unique_names

TIME = "time_ns"

_RATES = ("/s",)
_EFFORTS = ("N m", "Nm", "N", "A")


@dataclass(frozen=True)
class Array:
    """One array of numbers.

    Attributes:
        path: Where it stands in the group of its episode.
        is_action: Whether its numbers are those of the action, else of the state.
        places: Which numbers of the row's state or action, in order.
        names, units: What they are called.
    """

    path: str
    is_action: bool
    places: tuple[int, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]

    def __str__(self) -> str:
        titles = (f"{name} [{unit}]" if unit else name for name, unit in zip(self.names, self.units, strict=True))
        return f"{self.path}: {len(self.names)} numbers: {', '.join(titles)}"


def arrays(plan: Plan) -> list[Array]:
    """Return the arrays of an episode, that of the action last."""
    found = _by_key(plan) if plan.layout == "robomimic" else _by_quantity(plan)
    common = plan.rows.common
    units = [unit for one in common.action for unit in one.units]
    path = "actions" if plan.layout == "robomimic" else "action"
    return [*found, Array(path, True, tuple(range(len(units))), tuple(common.action_names), tuple(units))]


def picture_path(plan: Plan, camera: Camera) -> str:
    """Return where the pictures of a camera, or its depth, stand in the group of an episode."""
    if camera.step_m is not None:
        return f"obs/{_plain(camera.name)}" if plan.layout == "robomimic" else f"observations/images_depth/{camera.of}"
    return f"obs/{_plain(camera.name)}_image" if plan.layout == "robomimic" else f"observations/images/{camera.name}"


def described(plan: Plan) -> list[str]:
    """Return a line for each array of an episode."""
    common = plan.rows.common
    more = [
        f"{TIME}: the instant of a row [ns since the epoch]; {plan.rows.fps} rows per second, trim {plan.rows.trim}"
    ]
    if plan.layout == "robomimic":
        more = ["rewards: 1 in the last row where the operator said that the task was done, else 0",
                "dones: 1 in the last row, else 0", *more]  # fmt: skip
    what = "pixels, uint8 RGB" if plan.encoding == "rgb" else "JPEG files, uint8, zeros behind each"
    return [
        *(str(one) for one in arrays(plan)),
        *(f"{picture_path(plan, one)}: {one.key}, {one.width}x{one.height}, {what}" for one in common.cameras),
        *(
            f"{picture_path(plan, one)}: {one.key}, {one.width}x{one.height}, depth, uint16, {one.step_m:g} m, 0: none"
            for one in common.depths
        ),
        *more,
    ]


def _by_key(plan: Plan) -> Iterator[Array]:
    begin = 0
    for one in plan.rows.common.state:
        places = tuple(range(begin, begin + len(one.names)))
        yield Array(f"obs/{_plain(one.key)}", False, places, one.names, one.units)
        begin += len(one.names)


def _by_quantity(plan: Plan) -> Iterator[Array]:
    """Yield positions, velocities and efforts, as the units of the numbers say; the first two even where none is."""
    common = plan.rows.common
    units = [unit for one in common.state for unit in one.units]
    names = unique_names(common.state)
    kinds = [_quantity(unit) for unit in units]
    for kind in ("qpos", "qvel", "effort"):
        places = tuple(place for place, of in enumerate(kinds) if of == kind)
        if places or kind != "effort":
            yield Array(
                f"observations/{kind}", False, places, tuple(names[place] for place in places),
                tuple(units[place] for place in places),
            )  # fmt: skip


def _quantity(unit: str) -> str:
    if unit.endswith(_RATES):
        return "qvel"
    return "effort" if unit in _EFFORTS else "qpos"


def _plain(name: str) -> str:
    """Return a name that is one step of a path."""
    return name.replace("/", "_")
