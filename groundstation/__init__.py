"""A ground station that turns one short flight of a quadrotor into a model that can be trusted."""

import os

# The matrices here are small and one analysis is one core's work: threads inside BLAS only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
