"""Where each motor of an airframe sits and how it turns, by the numbers autopilots give to their frames.

Sources: ArduPilot, AP_MotorsMatrix (``setup_quad_matrix`` and its siblings; angles clockwise from ahead) and the
parameter documentation of FRAME_CLASS and FRAME_TYPE; PX4's airframe reference; Betaflight's and INAV's mixer
documentation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Airframe:
    """Motors in the autopilot's order.

    Attributes:
        name: as people call it.
        position: (x ahead, y left), any unit, shape (n, 2).
        spin: +1 counter-clockwise seen from above, -1 clockwise; empty where it is not known.
    """

    name: str
    position: Array
    spin: tuple[int, ...] = ()

    @property
    def count(self) -> int:
        """Number of motors."""
        return len(self.position)


def _by_angle(name: str, degrees: Sequence[float], spin: Sequence[int]) -> Airframe:
    angle = np.radians(degrees)
    return Airframe(name, np.column_stack([np.cos(angle), -np.sin(angle)]), tuple(spin))


_HEXA_H = np.array([[0, -1], [0, 1], [1, 1], [-1, -1], [1, -1], [-1, 1]], dtype=float)
_OCTA_H = np.array(
    [[1, -1], [-1, 1], [0.333, -1], [-1, -1], [1, 1], [-0.333, 1], [0.333, 1], [-0.333, -1]], dtype=float
)
_TWELVE = np.repeat([0.0, 60.0, 120.0, 180.0, -120.0, -60.0], 2)
_ALTERNATE_12 = (1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1)

ARDUPILOT: dict[tuple[int, int], Airframe] = {
    (1, 0): _by_angle("quad plus", (90, -90, 0, 180), (1, 1, -1, -1)),
    (1, 1): _by_angle("quad X", (45, -135, -45, 135), (1, 1, -1, -1)),
    (1, 2): _by_angle("quad V", (45, -135, -45, 135), (1, 1, -1, -1)),
    (1, 3): _by_angle("quad H", (45, -135, -45, 135), (-1, -1, 1, 1)),
    (1, 6): _by_angle("quad plus, reversed", (90, -90, 0, 180), (-1, -1, 1, 1)),
    (1, 12): _by_angle("quad X, Betaflight's order", (135, 45, -135, -45), (-1, 1, 1, -1)),
    (1, 13): _by_angle("quad X, DJI's order", (45, -45, -135, 135), (1, -1, 1, -1)),
    (1, 14): _by_angle("quad X, clockwise order", (45, 135, -135, -45), (1, -1, 1, -1)),
    (1, 18): _by_angle("quad X, Betaflight's order, reversed", (135, 45, -135, -45), (1, -1, -1, 1)),
    (2, 0): _by_angle("hexa plus", (0, 180, -120, 60, -60, 120), (-1, 1, -1, 1, 1, -1)),
    (2, 1): _by_angle("hexa X", (90, -90, -30, 150, 30, -150), (-1, 1, -1, 1, 1, -1)),
    (2, 3): Airframe("hexa H", _HEXA_H, (-1, 1, -1, 1, 1, -1)),
    (2, 13): _by_angle("hexa X, DJI's order", (30, -30, -90, -150, 150, 90), (1, -1, 1, -1, 1, -1)),
    (2, 14): _by_angle("hexa X, clockwise order", (30, 90, 150, -150, -90, -30), (1, -1, 1, -1, 1, -1)),
    (3, 0): _by_angle("octa plus", (0, 180, 45, 135, -45, -135, -90, 90), (-1, -1, 1, 1, 1, 1, -1, -1)),
    (3, 1): _by_angle("octa X", (22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5), (-1, -1, 1, 1, 1, 1, -1, -1)),
    (3, 3): Airframe("octa H", _OCTA_H, (-1, -1, 1, 1, 1, 1, -1, -1)),
    (3, 13): _by_angle("octa X, DJI's order", (22.5, -22.5, -67.5, -112.5, -157.5, 157.5, 112.5, 67.5), (1, -1) * 4),
    (3, 14): _by_angle(
        "octa X, clockwise order", (22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5), (1, -1) * 4
    ),
    (4, 0): _by_angle("octa quad plus", (0, -90, 180, 90, -90, 0, 90, 180), (1, -1) * 4),
    (4, 1): _by_angle("octa quad X", (45, -45, -135, 135, -45, 45, 135, -135), (1, -1) * 4),
    (4, 3): _by_angle("octa quad H", (45, -45, -135, 135, -45, 45, 135, -135), (-1, 1) * 4),
    (12, 0): _by_angle("dodeca hexa plus", tuple(_TWELVE), _ALTERNATE_12),
    (12, 1): _by_angle("dodeca hexa X", tuple(_TWELVE + 30.0), _ALTERNATE_12),
}
"""By FRAME_CLASS and FRAME_TYPE."""

ARDUPILOT_CLASSES = {
    **{1: "quad", 2: "hexa", 3: "octa", 4: "octa quad", 5: "Y6", 6: "helicopter", 7: "tricopter", 8: "single copter"},
    **{
        9: "coaxial copter",
        10: "bicopter",
        11: "dual helicopter",
        12: "dodeca hexa",
        13: "quad helicopter",
        14: "deca",
    },
}

PX4_AUTOSTART = {
    4: ARDUPILOT[1, 1],
    5: ARDUPILOT[1, 0],
    6: ARDUPILOT[2, 1],
    7: ARDUPILOT[2, 0],
    8: ARDUPILOT[3, 1],
    9: ARDUPILOT[3, 0],
}
"""By thousands of SYS_AUTOSTART, for logs before the control allocator (1.12 and earlier), which told no geometry."""

BETAFLIGHT_QUAD_X = ARDUPILOT[1, 12]
"""Betaflight and INAV: 1 rear right, 2 front right, 3 rear left, 4 front left."""
CRAZYFLIE = _by_angle("Crazyflie", (45, 135, -135, -45), (1, -1, 1, -1))
