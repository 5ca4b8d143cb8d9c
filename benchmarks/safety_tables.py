"""Put the tables of docs/safety.md together from docs/results/: python -m benchmarks.safety_tables"""

from __future__ import annotations

import json
import re
from pathlib import Path

from benchmarks import faults, hostile, soak

DOCUMENT = Path("docs/safety.md")
TABLES = {"faults": faults.table, "hostile": hostile.table, "soak": soak.table}


def main() -> None:
    """Replace what stands between the marks; a result that is not there leaves its table as it is."""
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, table in TABLES.items():
        results = Path(f"docs/results/{name}.json")
        if results.is_file():
            made = table(json.loads(results.read_text(encoding="utf-8")))
            mark = re.compile(rf"(<!-- table: {name} -->\n).*?(<!-- end -->)", re.S)
            text = mark.sub(lambda m, made=made: f"{m[1]}{made}\n{m[2]}", text)
    DOCUMENT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
