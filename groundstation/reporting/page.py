"""The page around the sections: one HTML file with style, script, plotly and figures inside, and no way to the
network.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

from groundstation.json_types import JsonObject
from groundstation.reporting.markup import Child, Markup, element, fragment

POLICY = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:"
"""Content security policy: nothing is fetched, wherever the file is opened ('unsafe-eval': plotly compiles its
shaders).
"""


@dataclass
class Page:
    """Sections and figures as they are added; :meth:`html` writes the file."""

    title: str
    sections: list[tuple[str, str, Markup]] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def section(self, anchor: str, heading: str, *content: Child, folded: bool = False) -> None:
        """Add a section with a heading that the table of contents points at; one that is ``folded`` opens at a click,
        and for print.
        """
        if self.sections:  # the first one, the verdict, is always seen
            fold = {"open": None if folded else "", "class_": "fold"}
            body = element(
                "section", element("details", element("summary", element("h2", heading)), *content, **fold), id=anchor
            )
        else:
            body = element("section", element("h2", heading), *content, id=anchor)
        self.sections.append((anchor, heading, body))

    def figure(self, figure: JsonObject, caption: Child, *, class_: str | None = None) -> Markup:
        """Register a plotly figure and return the place it is drawn at."""
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = _finite(figure)
        place = element(
            "div",
            class_="plot",
            id=name,
            role="group",
            aria_labelledby=f"{name}-caption",
            style=f"min-height:{figure['layout'].get('height', 300)}px",
        )
        return element("figure", place, element("figcaption", caption, id=f"{name}-caption"), class_=class_)

    def html(self, header: Child, footer: Child) -> str:
        """The whole document."""
        contents = element(
            "nav",
            element("ul", [element("li", element("a", h, href=f"#{a}")) for a, h, _ in self.sections]),
            aria_label="Contents",
        )
        head = element(
            "head",
            element("meta", charset="utf-8"),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("meta", http_equiv="Content-Security-Policy", content=POLICY),
            element("meta", name="color-scheme", content="light dark"),
            element("title", self.title),
            element("style", Markup(_asset("report.css"))),
        )
        body = element(
            "body",
            element("a", "Skip to the verdict", href="#verdict", class_="skip"),
            element("header", header),
            contents,
            element("noscript", element("p", "The tables are complete; the figures need JavaScript.", class_="note")),
            element("main", [section for _, _, section in self.sections]),
            element("footer", footer),
            _plotly(),
            _payload("data-figures", json.dumps(self.figures, allow_nan=False, separators=(",", ":"))),
            element("script", Markup(_asset("report.js"))),
        )
        return "<!doctype html>\n" + fragment(element("html", head, body, lang="en")) + "\n"


def _finite(value: Any) -> Any:
    """The same document with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _payload(name: str, text: str) -> Markup:
    """Compressed text in an inert script element; base64 cannot end the element early."""
    packed = base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
    return element("script", Markup(packed), id=name, type="application/gzip")


@cache
def _plotly() -> Markup:
    """The plotting library, packed once per process."""
    from plotly.offline import get_plotlyjs

    return _payload("data-plotly", get_plotlyjs())


def _asset(name: str) -> str:
    return resources.files("groundstation.reporting").joinpath("assets", name).read_text(encoding="utf-8")
