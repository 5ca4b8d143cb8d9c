"""Fail when a test was skipped for a reason that is not expected here (.ci/expected-skips.txt)."""

from __future__ import annotations

import re
import sys
from pathlib import Path


def unexpected(output: str, allowed: list[str]) -> list[str]:
    """Skip lines of pytest's short summary whose reason matches none of the allowed patterns."""
    skips = [line for line in output.splitlines() if line.startswith("SKIPPED ")]
    return [line for line in skips if not any(re.search(pattern, line) for pattern in allowed)]


def main() -> int:
    """Read pytest's output; 1 when something was skipped that should not have been."""
    lines = Path(__file__).with_name("expected-skips.txt").read_text(encoding="utf-8").splitlines()
    allowed = [line for line in lines if line and not line.startswith("#")]
    if not Path("../shared/data").is_dir():
        allowed += ["shared/data", "traffic .*is not here"]
    found = unexpected(Path(sys.argv[1]).read_text(encoding="utf-8"), allowed)
    for line in found:
        print(f"unexpected skip: {line}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
