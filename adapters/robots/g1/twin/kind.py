"""The robot twin of a G1, as it can be named."""

from __future__ import annotations

from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.g1.twin.options import G1TwinOptions
from station.robot_twin import Twin, TwinKind


def _make(options: G1TwinOptions, faults: G1Faults) -> Twin:
    from adapters.robots.g1.twin.twin import G1Twin

    return G1Twin(options, faults)


KIND = TwinKind(
    name="g1",
    about="Unitree G1 with 29 joints on its DDS network: firmware, motors, remote, gantry, in MuJoCo at 1 kHz",
    options=G1TwinOptions,
    faults=G1Faults,
    make=_make,
    library="cyclonedds",
    extra="g1",
)
