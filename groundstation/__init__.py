"""A ground station that turns one short flight of a quadrotor into a model that can be trusted."""

__version__ = "0.1.0"
