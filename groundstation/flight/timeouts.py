"""Time-outs and periods of a flight's processes, in seconds: one full name for each, with the reason for its size.

Core, link and clients read them here, so that those which have to fit each other stand together
(``tests/test_flight_timeouts.py`` holds the relations). How long a phase of a flight may take is in
:class:`.sequence.Deadlines`; limits of the checks before a flight are in ``link/preflight.py``; what a profile knows of
its firmware is in the profile.
"""

from __future__ import annotations

# Any process

CHILD_STOP_S = 3.0
"""For a child to end after it was asked to; then it is ended. A link is never ended so: it may still have to land."""
STATUS_EVERY_S = 0.1
"""Between two status messages of core or link: as often as an eye follows."""

# Client

CORE_CONNECT_S = 30.0
"""For the core to be found on the bus: its interpreter starts and imports, in 18 s at a load of 14 on two cores."""

# Gate: a station's views on other machines

GATE_TURN_S = 0.1
"""Between two looks at whether the list of passes changed: a pass that is withdrawn is good for nothing so soon."""
GATE_LOOK_S = 0.5
"""Between two looks for a flight to share, and for its core to let the gate in."""
GATE_SAYS_S = 1.0
"""Between two words of a gate that has nothing new: less than the silence a view is told of."""
GATE_ANSWER_S = 2.0
"""For the core to answer an order from the gate: less than the 5 s that who asked waits for the gate."""
GATE_FOUND_S = 8.0
"""For a gate to be reached: a handshake over a network that loses one packet in ten."""
GATE_HEARD_S = 3.0
"""After that, for its first word; without one, the pass was withdrawn."""
POSES_AGAIN_S = 0.5
"""Until a camera computer asks its capture system again."""

# Core: the vehicle's process

VEHICLE_START_S = 120.0
"""For the vehicle's process to appear: the simulator's first start on a machine compiles it."""
VEHICLE_SILENT_S = 10.0
"""Silence of a vehicle's process that cannot be replaced, until it is given up: a busy machine stalls it for seconds.
"""
LINK_SILENT_S = 3.0
"""Silence of a link in flight until another is started, to land the vehicle and to say so. It says something fifty
times a second; one that is silent so long has sent no setpoint either, and the vehicle's own failsafe has begun."""
VEHICLE_LEAVE_S = 10.0
"""For the vehicle's process to end by itself at the end: a link restores parameters first."""
CREDIT_EVERY_S = 0.2
"""Between two grants of simulated time, which also say that the core lives."""

# Core: a lock-stepped vehicle (pacing.py)

SIMULATED_AHEAD_S = 1.0
"""In the air the vehicle runs this far ahead of what is written, so that neither waits for the other."""
SIMULATED_LOOK_S = 2.0
"""Simulated time on the ground before the checks are answered: twice what they need of each stream."""
SIMULATED_LOOK_AGAIN_S = 1.0
"""How much longer they look where that was not enough."""

# Core: the streams on the ground and in flight (ground_check.py)

STREAMS_LOOK_S = 1.0
"""Of recording before the streams are judged: a rate is counted over a second."""
STREAMS_PATIENCE_S = 5.0
"""Of recording after which a stream that is still missing fails the checks."""
STREAM_SILENT_S = 1.0
"""Age of a stream's newest sample from which it is called silent."""
STREAM_GAP_S = 0.5
"""A gap longer than this on a stream that has many samples a second: something stalls."""

# Link: what is sent again and again

HEARTBEAT_EVERY_S = 1.0
"""Between two heartbeats of the station: MAVLink's own rate, which a ground-station failsafe counts on."""
TIMESYNC_EVERY_S = 0.1
"""Between two questions for the vehicle's clock."""
TIMESYNC_ON_A_LINE_EVERY_S = 0.5
"""The same where a line's bytes are few."""
PUBLISH_EVERY_S = 0.02
"""Between two batches of samples on the bus: fifty a second show a flight without delay, and keep the overhead small.
"""
RAW_LOG_SYNC_EVERY_S = 1.0
"""Between two writes of the raw log to the disk: what a power failure may cost."""
SIGNING_MEMORY_EVERY_S = 1.0
"""Between two writes of the signing stamps."""
STRANGERS_TOLD_EVERY_S = 5.0
"""Between two notes about strangers on the port."""

# Link: its loop

IDLE_WAIT_S = 0.02
"""Longest wait for the port in one turn."""
CATCH_UP_S = 0.1
"""So long an order waits for what arrived before it to be taken in."""
LATE_STEP_S = 0.1
"""A step that comes later than this after the one before follows a stall: what waits in the port is heard before the
guard judges.
"""
SWITCH_INTERVAL_S = 2e-4
"""A thread that publishes or logs gives the interpreter up so soon; the default, 5 ms, is how late setpoints left."""
LOG_FETCH_WAIT_S = 0.005
"""Longest wait for the port while a log is fetched."""

# Link: finding the vehicle, and losing it

VEHICLE_HEARD_S = 45.0
"""For the first heartbeat: an autopilot that was just powered boots for half a minute."""
VEHICLE_READY_S = 75.0
"""After it, for parameters and rates: a slow line carries a thousand parameters in half of that; indoors the autopilot
may have to be started again, and its estimator to take the poses."""
LANDED_STATE_S = 1.5
"""For the vehicle to say whether it is on the ground, where it was found armed."""
LOG_FETCH_HEARD_S = 15.0
"""For the first heartbeat when a log is fetched: the vehicle is powered already."""
ADDRESS_SILENT_S = 1.0
"""So long the bound address must be silent before another is listened to in flight."""
VEHICLE_LOST_S = 180.0
"""With the core gone, a vehicle not heard for so long is beyond this link: its battery or its own failsafe has ended
it.
"""
TAKEN_OVER_HOLD_S = 60.0
"""How long a vehicle found in flight is held before it is landed."""
PARAMETERS_RESTORED_S = 5.0
"""For the parameters to be put back at the end."""
RESTART_BEGUN_S = 3.0
"""After a restart was accepted: until then an autopilot that is about to go may still be heard."""
RESTARTED_S = 25.0
"""For its first heartbeat after that."""
POSES_FUSED_S = 20.0
"""For an estimator to take external poses: ArduPilot's aligns its yaw first, PX4's resets to them within seconds."""
POSES_STEADY_S = 3.0
"""How long it must have used them, its own checks passed: PX4's fail for a second or two after the reset."""

# Link: orders and answers

ORDER_ANSWERED_S = 4.6
"""For an order to be answered: less than the 5 s that who asked waits on the bus."""
SETPOINTS_FIRST_S = 0.6
"""Of setpoints before the mode that follows them is asked for: PX4 wants them for half a second."""
MODE_CHANGED_S = 2.0
"""For a mode to be seen in a heartbeat, of which one comes every second."""
CLIMB_S = 30.0
"""For the height of a take-off to be reached."""
ORDER_AGAIN_S = 0.5
"""Between two orders to hold, land or stop the motors that are not obeyed yet."""
RATES_MEASURED_S = 2.5
"""Of counting messages before a rate is judged."""
SCRIPT_HEARD_S = 5.0
"""For the script on board to report after it was uploaded."""
SCRIPT_SILENT_S = 2.0
"""Silence of the script on board that counts as its end. Reports come ten times a second; on a telemetry radio one in a
second may get through."""

UNTIL_AHEAD_S = 1.0
"""Before a rest point, when it is decided whether the excitation ends there: time for the order to arrive."""
UNTIL_SIMULATED_AHEAD_S = 0.2
"""The same where simulated time stands still until the order is answered."""
UNTIL_PREVIEW_S = 1.0
"""Between two looks that only the screen gets."""
SUSPECTS_EVERY_S = 5.0
"""Between two diagnoses of a flight while it flies."""
WINDOW_MOVED_S = 0.5
"""By less, an excitation's window that is told again is the same one: a link's clock runs a little differently each
time.
"""

CLOCK_DAEMON_S = 2.0
"""What the host's own clock daemon (chrony, PTP) may take to answer a question; without it its state is left out."""

MOCAP_FIRST_FRAME_S = 3.0
"""How long a survey waits for a camera system's first frame: a connection and a few frames of the slowest one."""
