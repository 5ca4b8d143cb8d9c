"""Golden results: what identify, diagnose, predict and plan gave on fixed flights, to the last bit.

    python -m benchmarks.golden                compare the short and the long cases with tests/golden/results.json
    python -m benchmarks.golden --short        the short cases alone (the test suite compares these)
    python -m benchmarks.golden --freeze       run all and write the file anew, with the commit and the machine

A move of code keeps every number. A change of behaviour changes some: freeze anew and say in the commit which and why.
Numbers are equal bit by bit where libraries and processor are those of the file; on other machines findings are, and
identified values within ``ELSEWHERE`` of their standard deviations.
Sentences are not compared, only numbers, names, verdicts and what was found.
"""

from __future__ import annotations

import argparse
import sys
import time

from studies.golden import ELSEWHERE, LONG, SEED, SHORT, Missing, compare, environment, freeze, frozen


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="the short cases alone")
    parser.add_argument("--freeze", action="store_true", help="write the file anew")
    options = parser.parse_args()
    if options.freeze:
        freeze()
        return 0
    golden = frozen()
    same = environment() == golden["environment"]
    elsewhere = f"another machine: what was found, and estimates within {ELSEWHERE:g} standard deviations"
    print(f"golden results of {golden['commit']}, seed {SEED}; {'bit by bit' if same else elsewhere}")
    failed = 0
    for case in SHORT if options.short else (*SHORT, *LONG):
        start = time.process_time()
        try:
            found = compare(case, golden)
        except Missing as missing:
            print(f"{case.__name__:<24} skipped: {missing}")
            continue
        failed += bool(found)
        print(
            f"{case.__name__:<24} {'equal' if not found else f'{len(found)} differ'}  "
            f"{time.process_time() - start:.1f} s of CPU",
            flush=True,
        )
        for line in found[:20]:
            print(f"    {line}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
