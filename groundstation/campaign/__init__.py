"""Flight after flight until the targets are met and nothing is missing: what to fly next, how the model did on it, when
to stop.
"""
