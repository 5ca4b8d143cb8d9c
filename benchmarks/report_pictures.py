"""Pictures of a report in a real browser: the first screen at three widths. `python -m benchmarks.report_pictures
REPORT [--output FOLDER]`

--whole adds the whole page, with every section open and every figure drawn.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import tempfile
from pathlib import Path

from tests import browser

SIZES = ((400, 800), (1000, 800), (1600, 900))
"""A phone, a laptop's half and a desk's screen."""
LOADED = "new Promise((r) => document.readyState === 'complete' ? r() : addEventListener('load', r))"
SETTLED = """(async () => {
  const frames = () => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)));
  for (let i = 0; i < 200; i++) {
    const [done, all] = (document.documentElement.dataset.drawn || "0/1").split("/");
    if (done === all || (i > 30 && !WHOLE)) break;
    await new Promise((r) => setTimeout(r, 50));
    await frames();
  }
  return [document.documentElement.scrollWidth, document.documentElement.scrollHeight];
})()"""


async def take(report: Path, folder: Path, name: str, *, whole: bool = False, dark: bool = False) -> list[Path]:
    """A PNG for each width."""
    made = []
    with tempfile.TemporaryDirectory() as profile:
        async with browser.page(Path(profile)) as page:
            for width, height in SIZES:
                await page.open(report.resolve().as_uri())
                await page.ask(
                    "Emulation.setDeviceMetricsOverride",
                    width=width,
                    height=height,
                    deviceScaleFactor=1,
                    mobile=width < 500,
                )
                scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
                await page.ask("Emulation.setEmulatedMedia", media="screen", features=[scheme])
                await page.value_of(LOADED)
                across, down = await page.value_of(SETTLED.replace("WHOLE", str(whole).lower()))
                assert across <= width, f"{report}: {across} pixels wide on a screen of {width}"
                shot = {
                    "captureBeyondViewport": True,
                    "clip": {"x": 0, "y": 0, "width": width, "height": down, "scale": 1},
                }
                picture = await page.ask("Page.captureScreenshot", format="png", **(shot if whole else {}))
                made.append(folder / f"{name}-{width}{'-whole' if whole else ''}.png")
                made[-1].write_bytes(base64.b64decode(picture["data"]))
    return made


def main() -> None:
    """Take them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=Path)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    parser.add_argument("--name", default="report")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--dark", action="store_true")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    take_all = take(arguments.report, arguments.output, arguments.name, whole=arguments.whole, dark=arguments.dark)
    for path in asyncio.run(take_all):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
