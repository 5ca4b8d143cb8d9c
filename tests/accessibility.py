"""axe-core, Deque's checker of accessibility, where its package is installed (.ci/run fetches it, pinned and without
its Playwright).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests import browser

ABSENT = "axe-core is not installed (.ci/accessibility.txt)"
SERIOUS = ("serious", "critical")
RUN = """axe.run(document, { resultTypes: ["violations"] }).then((found) => found.violations.map((v) => ({
  id: v.id, impact: v.impact, help: v.help, nodes: v.nodes.length, first: v.nodes[0].html.slice(0, 300),
  why: v.nodes[0].failureSummary,
})))"""


def axe_source() -> Path | None:
    """The script, as the package ships it; None where it is not installed."""
    import sysconfig

    path = Path(sysconfig.get_paths()["purelib"]) / "axe_playwright_python" / "axe.min.js"
    return path if path.is_file() else None


async def findings(page: browser.Page, source: Path) -> list[dict[str, Any]]:
    """What axe says against the page that is open, the serious and critical ones."""
    await page.value_of(source.read_text(encoding="utf-8") + "; 1")
    return [found for found in await page.value_of(RUN) if found["impact"] in SERIOUS]
