"""Command lines of the simulators: a fault is one sentence."""

from __future__ import annotations

import argparse
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """The same as argparse's, without the usage before each fault."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, and end."""
        self.exit(2, f"{message}; `{self.prog} -h` shows how it is called.\n")
