"""Where the joints of a Kassow arm sit, by model.

Source of the KR810's numbers: b-robotized/kassow_kord_driver,
``kassow_kord_description/kr810/urdf/kr810_description.urdf.xacro`` (joints 1 to 7 and the fixed ones between them,
joined here). Axis 2 stands 50 mm in front of axis 1 and axis 4 40 mm beside axis 3, which is why both fold farther
forwards than back; the arm goes on beside them, and comes back at the next. The tool is the flange: the frame of the
last link, there and here.
"""

from __future__ import annotations

from adapters.robots.serial_chain import Hinge, SerialChain
from station.errors import ConfigError

KR810 = SerialChain(
    (
        Hinge((0.0, 0.0, 0.035), "z"),
        Hinge((0.05, 0.0, 0.2737), "y"),
        Hinge((-0.05, -0.0857, 0.274), "z"),
        Hinge((0.04, 0.0, 0.1429), "y"),
        Hinge((-0.04, 0.08405, 0.271), "z"),
        Hinge((0.0, 0.0, 0.1035), "y"),
        Hinge((0.0, 0.111, 0.108), "z"),
    )
)

MODELS: dict[str, SerialChain] = {"kr810": KR810}
"""What is known; another model can be driven joint by joint, with a file of its limits."""

REACHING_DOWN = (0.0, 0.35, 0.0, 1.6, 0.0, 1.191592654, 0.0)
"""Joints of an arm in the middle of its work, the tool pointing down [rad]: far from every limit and singularity."""


def chain(model: str) -> SerialChain:
    """Return the kinematics of a model.

    Raises:
        ConfigError: nothing is known of them.
    """
    if model not in MODELS:
        raise ConfigError(
            f"model {model!r}: its kinematics are not known, only those of {', '.join(MODELS)}; drive its joints with "
            "the driver arm-joints, or add it to adapters/robots/kassow/kinematics.py"
        )
    return MODELS[model]
