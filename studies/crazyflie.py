"""Three 1 kHz logs of a Crazyflie 2.1, what their authors published, and the body rate that a model predicts
(``benchmarks.crazyflie``).

Against: constant rate; the declared vehicle (pendulum and bench values of Foerster 2015); and the constants the logs'
authors published (moments 1.03, 1.11 and 1.95e-5 kg m^2, one lag of 72 to 75 ms, accelerometer scaled by 9.18).
"""

from __future__ import annotations

import numpy as np

from groundstation.flightdata import FlightData
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.identification.starts import flight_states
from groundstation.model.prediction import predict
from groundstation.model.predictive import PredictiveModel
from groundstation.model.vehicle_model import VehicleModel, model_from_document
from groundstation.vehicle import Vehicle

SEEN = (("log10", 35.0, 65.0), ("log15", 55.0, 75.0), ("log16", 32.0, 38.0))
UNSEEN = (("log15", 75.0, 90.0), ("log16", 44.5, 49.5))
HORIZONS_S = (0.02, 0.05, 0.1, 0.5)
PUBLISHED = {"ixx_kg_m2": 1.03e-5, "iyy_kg_m2": 1.11e-5, "izz_kg_m2": 1.95e-5}
PUBLISHED_LAG_S = 0.0735
PUBLISHED_SCALE = 9.18 / 9.81
WINDOW_S = 0.1


def published(document: dict, vehicle: Vehicle) -> VehicleModel:
    """The published moments and lag; as no thrust curve is quoted with them, ours scaled as their accelerometer was."""
    values = {name: {"value": value} for name, value in PUBLISHED.items()}
    values |= {name: {"value": 0.0} for name in ("ixy_kg_m2", "ixz_kg_m2", "iyz_kg_m2")}
    curve = {
        name: {"value": PUBLISHED_SCALE * entry["value"]}
        for name, entry in document["model"].items()
        if name.startswith("thrust_curve")
    }
    lag = {"rotor_lag_up_s": {"value": PUBLISHED_LAG_S}, "rotor_lag_down_s": {"value": PUBLISHED_LAG_S}}
    return model_from_document({"parameters": values, "model": {**curve, **lag}}, vehicle)


def table(model: dict[str, VehicleModel | PredictiveModel | None], flight: FlightData) -> str:
    """RMS error of the predicted body rate by model and horizon, Markdown."""
    states = flight_states(flight)
    lines = ["| model | " + " | ".join(f"{h:g} s" for h in HORIZONS_S) + " |", "|---|" + "---|" * len(HORIZONS_S)]
    constant = []
    for name, each in model.items():
        row = []
        for horizon in HORIZONS_S:
            error = predict(each, states, horizon_s=horizon).error
            row.append(error["model"][f"{horizon:g}"]["body_rate_rad_s"]["rms"])
            if len(constant) < len(HORIZONS_S):
                constant.append(error["constant_velocity"][f"{horizon:g}"]["body_rate_rad_s"]["rms"])
        lines.append(f"| {name} | " + " | ".join(f"{e:.3f}" for e in row) + " |")
    lines.append("| constant rate | " + " | ".join(f"{e:.3f}" for e in constant) + " |")
    inside = (states.t_s >= states.window_s[0]) & (states.t_s <= states.window_s[1])
    still = float(np.sqrt(np.mean(np.sum(states.rate_rad_s[inside] ** 2, axis=1))))
    lines.append("| no rate at all | " + " | ".join([f"{still:.3f}"] * len(HORIZONS_S)) + " |")
    return "\n".join(lines)


def lateral_force(flight: FlightData) -> str:
    """How much of the torque that a fit leaves goes with the lateral force the accelerometer felt, and at what height
    that acts.

    Torque from differences of the rate residual over WINDOW_S, by least squares on a constant and the mean force of the
    same window; a force F at height h above the centre of mass makes the torque (-h F_y, h F_x).
    """
    fitted = fit_dynamics([prepare(flight)])
    model, best = fitted.models[0], fitted.best.parameters
    residual = model.residual(best)[:, :3]
    step = round(WINDOW_S / float(np.median(model.dt)))
    torque = (residual[step:] - residual[:-step])[::step] / WINDOW_S @ best.tensor
    mean = np.cumsum(model.force[:, :2], axis=0)
    force = best.mass_kg * ((mean[step:] - mean[:-step]) / step)[::step]
    columns = np.column_stack([np.ones(len(force)), force])
    arms, left = [], []
    for axis in range(2):
        solution, *_ = np.linalg.lstsq(columns, torque[:, axis], rcond=None)
        arms.append(solution[1:])
        left.append(float(np.std(torque[:, axis] - columns @ solution) / np.std(torque[:, axis])))
    shares = " | ".join(f"{100.0 * (1.0 - each**2):.0f} %" for each in left)
    return f"{shares} | {-1e3 * arms[0][1]:.0f} mm | {1e3 * arms[1][0]:.0f} mm"
