# %% [markdown]
# # An effect of your own
#
# Something pulls the vehicle, and no effect in the library knows it. Here a wall at x = 1.5 m attracts the vehicle. We find
# the residual, write a model of it in ten lines, and let the diagnosis judge it.

# %%
import numpy as np

from groundstation import api

scenario = api.load_scenario("lab")
scenario["effects"] = {"attracting_wall": {"strength_n_m3": 3.0}}
plan = api.load_plan("qball2").model_copy(update={"periods": 4.0})
flight = api.simulate("qball2", scenario=scenario, plan=plan, seed=3)
before = api.diagnose(flight)
print(before.verdict, "-", before.reason)
before.to_frame()

# %% [markdown]
# ## The model
#
# An effect is linear in its parameters. Its `wrench` gives body force and torque per unit of each parameter, shape
# (samples, 6, parameters). A force that is fixed in the room is turned into the body first.

# %%
from groundstation.diagnosis.effect import Effect, ParameterInfo, blank
from groundstation.frames import quat_rotate_inverse


def wrench(signals, vehicle, settings):
    distance_m = 1.5 - signals.position_m[:, 0]
    toward_wall = np.zeros_like(signals.position_m)
    toward_wall[:, 0] = 1.0 / (distance_m + 0.5) ** 3
    out = blank(signals)
    out[:, :3, 0] = quat_rotate_inverse(signals.quaternion, toward_wall)
    return out


WALL = Effect(
    identifier="wall_at_x",
    equation="F = k / (d + 0.5)^3 towards the wall",
    source="this notebook",
    parameters=(ParameterInfo("strength_n_m3", lambda vehicle: 10.0, (0.0, 50.0)),),
    wrench=wrench,
    sentence="The wall attracts with {strength_n_m3} N m³ over the cube of the distance.",
    confused_with=("constant_wrench", "tether"),
    manoeuvre="fly close to the wall and far from it",
)
api.register_effect(WALL)

# %% [markdown]
# ## The judgement
#
# The same diagnosis, now with one candidate more. It keeps the effect only if the error falls on data that no estimate saw.

# %%
after = api.diagnose(flight)
print(after.verdict, "-", after.reason)
after.to_frame()

# %%
api.plot(after)

# %% [markdown]
# The simulator's strength was 3.0 N m³. To keep an effect, put the same definition into a file of
# `groundstation/diagnosis/effects/` with the name `EFFECT`; docs/extending.md shows it together with the simulator's side.
