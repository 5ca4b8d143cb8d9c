# %% [markdown]
# # The paper reproduced
#
# The seed paper identifies a QBall 2 from one trajectory (its Table 2) with four methods: least squares (LS), gradient descent
# (GD), and both with filters (FMLS, FMGD). Here the same trajectory is flown in simulation, and the same methods stand beside
# ours. `groundstation reproduce` makes all tables.

# %%
import pandas as pd

from groundstation import api

plan = api.load_plan("paper_table2")
api.plot(plan)

# %% [markdown]
# The condition number of the stacked regressor is the paper's criterion.

# %%
from groundstation.reproduction import trajectory_facts

pd.Series(trajectory_facts())

# %%
flight = api.simulate("qball2", scenario="seed", plan=plan, seed=1)
found = api.identify(flight)
truth, declared = flight.truth.parameters(), flight.vehicle.parameters()
columns = {
    name: {p: e.value for p, e in method.parameters.items()}
    for name, method in found.methods.items()
    if name in ("LS", "GD", "FMLS", "FMGD", found.best)
}
pd.DataFrame({"declared": declared, "true": truth, **columns}).loc[list(found.methods["LS"].parameters)]

# %% [markdown]
# Standard least squares differentiates noisy rates, and its tensor suffers. The filtered methods avoid the derivative. The
# last column is the method of this program that was judged best, with an interval for each number:

# %%
api.plot(found, flight)
