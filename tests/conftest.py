"""Set before numpy is imported: the suite's workers share the cores, where threads over matrices as small as ours only
wait. And shapes are held before anything of ours is.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
import shapes

shapes.install()

FAST = {
    "test_cli_words",
    "test_flight_sequence",
    "test_guard_limits",
    "test_mavlink_codec",
    "test_mavlink_timesync",
    "test_planning_criteria",
    "test_preflight_checks",
    "test_recording_bundle",
    "test_recording_computed_speeds",
    "test_recording_crazyflie",
    "test_recording_golden",
    "test_recording_mcap",
    "test_recording_merge",
    "test_recording_repair",
    "test_reporting_autopilots",
    "test_reporting_exports",
    "test_reporting_simulators",
    "test_reporting_units",
    "test_seed_closed_loop",
    "test_seed_estimators",
    "test_seed_filters",
    "test_seed_processing",
    "test_seed_regressors",
    "test_sim_control",
    "test_sim_plant",
    "test_sim_scenario",
    "test_tui_text",
    "test_writing",
}
"""Test files of ``make test-fast``: no processes, terminals, browsers or long flights. All others are marked slow."""


def pytest_collection_modifyitems(items):
    """Mark what ``make test-fast`` leaves out."""
    for item in items:
        if item.path.stem not in FAST:
            item.add_marker("slow")


@pytest.fixture(scope="session", autouse=True)
def own_configuration(tmp_path_factory):
    """The user's configuration folder is left alone: keys are made in one of the tests' own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
        yield
