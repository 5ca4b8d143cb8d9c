"""Effects of the shared vocabulary, each with its own physics, and three that no library has. See :data:`Effects`.

A scenario switches one on by a table ``[effects.<identifier>]``; every parameter has a default, sized for a vehicle of
one to two kilograms. They are written apart from the models that explain flights, from other sources, on purpose. One
that pushes or turns the body by its motion is a file of its own, found by itself (:mod:`sim.effects.bodily`); one that
acts inside rotors, battery or sensors is a field of :class:`Inside`.
"""

from __future__ import annotations

from collections import namedtuple
from typing import TYPE_CHECKING, NamedTuple

from sim.effects import bodily
from sim.effects.actuation import BatterySag, InputDelay, MotorLag, RotorGyroscopic
from sim.effects.airframe import Wind
from sim.effects.attachments import ComOffset, PayloadChange, SlungLoad, Tether
from sim.effects.instruments import ClockOffset, ImuMisalignment, MocapMisalignment, MocapTilt
from sim.effects.rotor_aerodynamics import ClimbInflow, FlappingMoment, GroundEffect, RotorDrag, TranslationalLift
from sim.effects.rotor_faults import RotorDegradation, ThrustCurve, ThrustMemory, ThrustScale, TorqueScale, WeakRotor
from sim.effects.surroundings import AttractingWall, ConstantWrench, Magnet


class Inside(NamedTuple):
    """Effects that have their place inside the plant, its sensors and its surroundings, switched off."""

    motor_lag: MotorLag = MotorLag(on=False)
    input_delay: InputDelay = InputDelay(on=False)
    clock_offset: ClockOffset = ClockOffset(on=False)
    rotor_drag: RotorDrag = RotorDrag(on=False)
    flapping_moment: FlappingMoment = FlappingMoment(on=False)
    translational_lift: TranslationalLift = TranslationalLift(on=False)
    climb_inflow: ClimbInflow = ClimbInflow(on=False)
    ground_effect: GroundEffect = GroundEffect(on=False)
    wind: Wind = Wind(on=False)
    weak_rotor: WeakRotor = WeakRotor(on=False)
    thrust_scale: ThrustScale = ThrustScale(on=False)
    torque_scale: TorqueScale = TorqueScale(on=False)
    thrust_curve: ThrustCurve = ThrustCurve(on=False)
    rotor_degradation: RotorDegradation = RotorDegradation(on=False)
    com_offset: ComOffset = ComOffset(on=False)
    rotor_gyroscopic: RotorGyroscopic = RotorGyroscopic(on=False)
    battery_sag: BatterySag = BatterySag(on=False)
    payload_change: PayloadChange = PayloadChange(on=False)
    slung_load: SlungLoad = SlungLoad(on=False)
    tether: Tether = Tether(on=False)
    constant_wrench: ConstantWrench = ConstantWrench(on=False)
    imu_misalignment: ImuMisalignment = ImuMisalignment(on=False)
    mocap_misalignment: MocapMisalignment = MocapMisalignment(on=False)
    mocap_tilt: MocapTilt = MocapTilt(on=False)
    attracting_wall: AttractingWall = AttractingWall(on=False)
    thrust_memory: ThrustMemory = ThrustMemory(on=False)
    magnet: Magnet = Magnet(on=False)


_BODILY = bodily.found()

if TYPE_CHECKING:
    Effects = Inside
else:
    Effects = namedtuple(
        "Effects",
        (*Inside._fields, *_BODILY),
        defaults=(*Inside(), *(module.EFFECT(on=False) for module in _BODILY.values())),
        module=__name__,
    )
    """All effects by identifier, switched off; what a scenario does not name stays so."""

bodily_wrench = bodily.summed([(Effects._fields.index(name), module.wrench) for name, module in _BODILY.items()])
"""(effects, motion, force, torque) -> force and torque in the body with what the body's effects add."""
