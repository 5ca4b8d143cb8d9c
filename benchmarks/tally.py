"""Outcomes of blind flights counted: shares with Wilson's bounds, confusion, detection limits, bias of the parameters.

``python -m benchmarks.tally ROWS [ROWS ...]`` prints one table over the rows that several runs of ``benchmarks.blind
--rows`` kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from studies.tally import load, report


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.tally", description="One table over several runs of the blind bench."
    )
    parser.add_argument("rows", type=Path, nargs="+", help="files that benchmarks.blind --rows wrote")
    report([outcome for path in parser.parse_args(argv).rows for outcome in load(path)])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
