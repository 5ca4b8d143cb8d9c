"""One flight's data for a dynamic fit: what was measured, and the motion that was asked for, at the IMU's stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.parts import double
from groundstation.model.rotors import MotorInput
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LATEST_S = 1.0
"""By which commands come before what they do, at most."""


@dataclass(frozen=True, slots=True)
class DynamicRecord:
    """One flight's data for the dynamic fit, at the IMU's stamps (the IMU's clock).

    Attributes:
        t_s: stamps, (k,). keep: samples inside the window and outside exclusions, (k,).
        rate_rad_s: rates less their bias, (k, 3).
        force_m_s2: specific force of the declared origin less bias and lever arm, (k, 3); NaN when there is no
            accelerometer.
        force_bias_std: what is left unknown of the bias, (3,).
        motors: on the motors' clock.
        block: samples averaged into one for the fit, the same on both sides of the equation.
    """

    vehicle: Vehicle
    t_s: Annotated[Array, "k"]
    keep: Annotated[Mask, "k"]
    rate_rad_s: Annotated[Array, "k 3"]
    force_m_s2: Annotated[Array, "k 3"]
    force_bias_std: Annotated[Array, "3"]
    motors: MotorInput
    block: int = 1

    def part(self, samples: slice) -> DynamicRecord:
        """Some of the samples, and the motors from LATEST_S before to LATEST_S after them: views."""
        t_s, motors = self.t_s[samples], self.motors
        times = np.array([t_s[0] - LATEST_S, t_s[-1] + LATEST_S])
        rows = slice(*np.clip(((times - motors.start_s) / motors.step_s).astype(int), 0, len(motors.value)).tolist())
        start_s = motors.start_s + rows.start * motors.step_s
        return replace(
            self,
            t_s=t_s,
            keep=self.keep[samples],
            rate_rad_s=self.rate_rad_s[samples],
            force_m_s2=self.force_m_s2[samples],
            motors=replace(motors, start_s=start_s, value=motors.value[rows]),
        )


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """The motion that was asked for, at the IMU's stamps: it owes nothing to this flight's disturbances. Of a long
    flight it is in single precision, and :meth:`part` in double.

    Attributes:
        rate_rad_s: body rates, (k, 3).
        angular_acceleration_rad_s2: (k, 3).
        specific_thrust_m_s2: thrust over mass, (k,).
        velocity_body_m_s: (k, 3).
        position_m: (k, 3).
        quaternion: (k, 4), continuous in sign.
        extra: planned values of each BodyWrench term, as :attr:`BodyWrench.value`.
    """

    rate_rad_s: Annotated[Array, "k 3"]
    angular_acceleration_rad_s2: Annotated[Array, "k 3"]
    specific_thrust_m_s2: Annotated[Array, "k"]
    velocity_body_m_s: Annotated[Array, "k 3"]
    position_m: Annotated[Array, "k 3"]
    quaternion: Annotated[Array, "k 4"]
    extra: tuple[Array, ...] = ()

    def part(self, samples: slice) -> PlannedMotion:
        """Some of the instants."""
        return PlannedMotion(
            double(self.rate_rad_s[samples]),
            double(self.angular_acceleration_rad_s2[samples]),
            double(self.specific_thrust_m_s2[samples]),
            double(self.velocity_body_m_s[samples]),
            double(self.position_m[samples]),
            double(self.quaternion[samples]),
            tuple(double(values[samples]) for values in self.extra),
        )
