"""The simulator as physics for an autopilot's own firmware: ArduPilot's JSON interface and PX4's simulator link.

The exchanges (:mod:`sim.firmware.arducopter`, :mod:`sim.firmware.px4`) hold no sockets; :mod:`sim.firmware.__main__`
does.
"""
