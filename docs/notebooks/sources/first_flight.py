# %% [markdown]
# # A first flight
#
# Fly a simulated QBall 2, estimate its mass and inertia, and ask what the declared vehicle lacks. Everything here works the
# same on a recording of your own: replace `simulate` by `load_flight("flight.mcap")`.

# %%
from groundstation import api

plan = api.load_plan("qball2").model_copy(update={"periods": 4.0})  # 20 s of excitation
flight = api.simulate("qball2", scenario="lab", plan=plan, seed=1)
found = api.identify(flight)
api.plot(found, flight)

# %% [markdown]
# Each row is one parameter with its 95 % interval. The declared value comes from the vehicle file. The true value is known
# because the vehicle is simulated. No estimator reads it.

# %%
flight

# %%
found.to_frame().head(7)

# %% [markdown]
# ## What was flown

# %%
api.plot(flight)

# %% [markdown]
# ## What the declared vehicle lacks
#
# A diagnosis traces the residual to effects. In this laboratory the motion capture stamps its poses on another clock, and
# that is what it finds.

# %%
diagnosis = api.diagnose(flight)
print(diagnosis.verdict)
for finding in diagnosis.findings:
    print(f"{finding.confidence:.0%}  {finding.sentence}")

# %%
api.plot(diagnosis)

# %% [markdown]
# ## Does the model predict another flight?
#
# The model simulates ahead from every sample of a flight that no estimate saw, with the recorded rotor speeds.

# %%
model = api.model_document(found, flight.vehicle, diagnosis)
paper = api.load_plan("paper_table2").model_copy(update={"periods": 1.0})
other = api.simulate("qball2", scenario="lab", plan=paper, seed=2)
prediction = api.predict(model, other, horizon_s=0.5)
api.plot(prediction)

# %% [markdown]
# ## Take it elsewhere
#
# `api.export` writes the model for a simulator; `api.write_report` writes the HTML report.

# %%
print(api.export(model, "mjcf")[:600])
