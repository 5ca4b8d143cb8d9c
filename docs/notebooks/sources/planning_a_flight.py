# %% [markdown]
# # Planning a flight
#
# A plan is a finite Fourier series in x, y, z and yaw. The optimiser chooses it so that the motion reveals mass and inertia
# within the limits of vehicle and room. It also says beforehand how well.

# %%
import math

from groundstation import api

plan = api.plan_excitation(
    "qball2", criterion="A", duration_s=16.0, time_budget_s=2.0, seed=1, tilt_max_rad=math.radians(15.0)
)
api.plot(plan)

# %%
plan

# %% [markdown]
# ## Is the prediction right?
#
# Fly the plan in simulation, identify, and compare the standard deviations that the plan promised with those of the estimate.

# %%
import pandas as pd

found = api.identify(api.simulate("qball2", scenario="lab", plan=plan, seed=4))
pd.DataFrame({"planned": plan.to_frame()["predicted_std"], "estimated": found.to_frame()["std"]}).dropna()

# %% [markdown]
# The plan cannot know this room's disturbance. It assumes a typical one, so agreement within a factor of three to five is
# what to expect.
#
# ## A smaller room
#
# Limits go by their names. A tighter room costs information, and the plan says how much.

# %%
small = api.plan_excitation(
    "qball2", criterion="A", duration_s=16.0, time_budget_s=2.0, seed=1, x_max_m=0.15, y_max_m=0.15, speed_max_m_s=0.5
)
pd.DataFrame({"wide": plan.to_frame()["predicted_std"], "small": small.to_frame()["predicted_std"]})
