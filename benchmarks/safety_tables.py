"""Put the tables of docs/safety.md and docs/machines.md together from docs/results/.

python -m benchmarks.safety_tables
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from benchmarks import faults, full_load, hostile, shared_station, soak

TABLES = {
    "safety": {"faults": faults.table, "hostile": hostile.table, "soak": soak.table, "full_load": full_load.table},
    "machines": {"shared_station": shared_station.table},
}
"""By document, and by result."""


def main() -> None:
    """Replace what stands between the marks; a result that is not there leaves its table as it is."""
    for name, tables in TABLES.items():
        document = Path(f"docs/{name}.md")
        text = document.read_text(encoding="utf-8")
        for result, table in tables.items():
            text = _filled(text, result, table)
        document.write_text(text, encoding="utf-8")


def _filled(text: str, result: str, table: Callable[[dict], str]) -> str:
    results = Path(f"docs/results/{result}.json")
    if not results.is_file():
        return text
    made = table(json.loads(results.read_text(encoding="utf-8")))
    mark = re.compile(rf"(<!-- table: {result} -->\n).*?(<!-- end -->)", re.S)
    return mark.sub(lambda m: f"{m[1]}{made}\n{m[2]}", text)


if __name__ == "__main__":
    main()
