"""Mutated inputs over every reader of files from outside: none may crash, hang over 20 s, or take more than 1 GB.

python -m benchmarks.fuzz                    # 20 000 inputs
python -m benchmarks.fuzz --count 1000000    # about 40 minutes of one core
python -m benchmarks.fuzz --minutes 60       # as many as fit
python -m benchmarks.fuzz --replay plan:17   # one input again, with its traceback

Seeds lie in tests/corpus, one folder a reader. Input k of a reader is a function of (seed, reader, k) alone. Inputs run
in child processes, one for up to two thousand inputs, that the system holds to 1 GB and that end themselves where one
input takes 20 s.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

from groundstation.writing import write_whole
from studies.fuzz import RESULTS, SEED, fuzz, replay
from studies.fuzz_readers import READERS


def main() -> int:
    """Run, print the table, keep the counts; 1 when anything crashed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--minutes", type=float, help="stop after so long, whatever the count")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--start", type=int, default=0, help="number of the first input of each reader")
    parser.add_argument("--reader", action="append", default=[], choices=list(READERS))
    parser.add_argument("--replay", metavar="READER:NUMBER")
    parser.add_argument("--keep", action="store_true", help=f"add the counts to {RESULTS.name}")
    options = parser.parse_args()
    if options.replay:
        replay(options.replay, options.seed)
        return 0
    began = time.monotonic()
    tally = fuzz(options.count, options.minutes, options.seed, tuple(options.reader), options.start)
    took = time.monotonic() - began
    print(f"seed {options.seed}, first input {options.start}: {tally.total()} inputs in {took:.0f} s")
    print(f"{'reader':<12}{'inputs':>9}{'read':>9}{'refused':>9}{'crashed':>9}{'peak MB':>9}")
    for row in tally.rows():
        print(f"{row['reader']:<12}" + "".join(f"{row[k]:>9}" for k in list(row)[1:]))
    for place, signature in tally.crashes().items():
        print(f"  {place}: {signature}")
    if options.keep:
        runs = json.loads(RESULTS.read_text(encoding="utf-8"))["runs"] if RESULTS.is_file() else []
        run = {"seed": options.seed, "start": options.start, "seconds": round(took), "crashes": tally.crashes()}
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        document = {"schema": "groundstation.fuzz/1", "runs": [*runs, {**run, "readers": tally.rows()}]}
        write_whole(RESULTS, json.dumps(document, indent=1) + "\n")
    return 1 if tally.crashes() else 0


if __name__ == "__main__":
    sys.exit(main())
