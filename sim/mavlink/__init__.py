"""The simulated autopilot: a vehicle of :mod:`sim` that speaks MAVLink as PX4 or ArduCopter do.

The core (:mod:`sim.mavlink.autopilot`) takes bytes and a time and gives bytes; sockets are in
:mod:`sim.mavlink.process`.
"""
