"""Excitation trajectories: what a flight must keep, what it will reveal, and the best one for a vehicle and a room."""

from groundstation.planning.criteria import CRITERIA, condition_number
from groundstation.planning.information import Noise, percentages, predicted_std
from groundstation.planning.plan import paper_plan, paper_problem, plan_document, plan_excitation

__all__ = [
    "CRITERIA",
    "Noise",
    "condition_number",
    "paper_plan",
    "paper_problem",
    "percentages",
    "plan_document",
    "plan_excitation",
    "predicted_std",
]
