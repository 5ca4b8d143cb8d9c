"""Effects of the shared vocabulary, each with its own physics, and three that no library has. See :data:`Effects`.

A scenario switches one on by a table ``[effects.<identifier>]``; every parameter has a default, sized for a vehicle of
one to two kilograms. They are written apart from the models that explain flights, from other sources, on purpose.
"""

from __future__ import annotations

from typing import NamedTuple

from sim.effects.actuation import BatterySag, InputDelay, MotorLag, RotorGyroscopic
from sim.effects.airframe import AngularDamping, BodyDrag, Wind
from sim.effects.attachments import ComOffset, PayloadChange, SlungLoad, Tether
from sim.effects.instruments import ClockOffset, ImuMisalignment, MocapMisalignment, MocapTilt
from sim.effects.rotor_aerodynamics import ClimbInflow, FlappingMoment, GroundEffect, RotorDrag, TranslationalLift
from sim.effects.rotor_faults import RotorDegradation, ThrustCurve, ThrustMemory, ThrustScale, TorqueScale, WeakRotor
from sim.effects.surroundings import AttractingWall, ConstantWrench, Magnet


class Effects(NamedTuple):
    """All effects by identifier, switched off; what a scenario does not name stays so."""

    motor_lag: MotorLag = MotorLag(on=False)
    input_delay: InputDelay = InputDelay(on=False)
    clock_offset: ClockOffset = ClockOffset(on=False)
    rotor_drag: RotorDrag = RotorDrag(on=False)
    body_drag: BodyDrag = BodyDrag(on=False)
    flapping_moment: FlappingMoment = FlappingMoment(on=False)
    angular_damping: AngularDamping = AngularDamping(on=False)
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
