"""The commands of ``groundstation``, by subject. Thin: parse, call, print; heavy imports inside the functions."""
