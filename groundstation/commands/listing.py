"""The commands in the order in which one uses them, with a line each: what ``groundstation --help`` prints without
loading any.
"""

from __future__ import annotations

SECTIONS: dict[str, dict[str, str]] = {
    "Plan and fly": {
        "plan": "Optimise an excitation trajectory for a vehicle and a room",
        "rehearse": "Fly the whole loop in simulation, from plan to report",
        "preflight": "Check a vehicle on its link before a flight",
        "fly": "Fly a vehicle on a MAVLink link; identify it after landing",
        "campaign": "Fly until the targets are met and nothing is missing",
        "sim": "Run the simulated drone or autopilot by itself",
    },
    "Analyse a flight": {
        "identify": "Estimate mass, inertia and more, with intervals",
        "diagnose": "Find which effect the declared vehicle lacks",
        "predict": "Predict a flight with a model, and score the errors",
        "report": "Identify and diagnose; write the HTML report",
    },
    "Use the results": {
        "export": "Write a model for a simulator, a firmware or a tool",
        "convert": "Convert recordings, flight bundles and logs",
        "compare": "Put flights side by side: what differs, how surely",
        "flights": "List, search and export flights; trends of parameters",
        "batch": "Analyse many recordings, on all cores or a cluster",
    },
    "This station": {
        "calibrate": "Measure how the marker body sits, by hand",
        "station": "Share this station with other machines; passes for them",
        "doctor": "Say what is missing or wrong here, and what to do",
        "reproduce": "Fly the paper's flights and print its tables beside ours",
        "completion": "Print a completion script for bash, zsh or fish",
    },
}
