# %% [markdown]
# # A Crazyflie from its log
#
# A measured flight: Crazyflie 2.1, micro-SD log at 1 kHz, no motion capture, motor commands only (data of *Data-Driven System
# Identification of Quadrotors Subject to Motor Delays*, MIT licence). What can such a log tell, and what can it not?
#
# The log is not part of this repository. Set `GROUNDSTATION_DATA` to the folder that holds `crazyflie-1khz/`.

# %%
import os
from pathlib import Path

from groundstation import api

log = Path(os.environ["GROUNDSTATION_DATA"]) / "crazyflie-1khz" / "log15"
flight = api.load_flight(log, vehicle="crazyflie21", start_s=55.0, end_s=90.0)
flight

# %%
api.plot(flight)

# %% [markdown]
# No pose was recorded, so position and attitude are unknown. Gyro, accelerometer and motor commands remain.

# %%
found = api.identify(flight)
api.plot(found, flight)

# %%
found.to_frame()

# %% [markdown]
# Parameters without a number are not revealed by this motion. The result says what would reveal them:

# %%
for name, remedy in found.not_identifiable.items():
    print(f"{name}: {remedy}")

# %% [markdown]
# Others made of the same log: lag 72 to 75 ms, Ixx 1.03e-5 and Iyy 1.11e-5 kg m². Bench values for this vehicle are near
# 1.66e-5 kg m². The interval above says which of them this flight supports.
