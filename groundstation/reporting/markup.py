"""HTML built from elements, so that text is escaped by construction: only :class:`Markup` passes as it is."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

VOID = {"meta", "br", "hr", "link"}


class Markup(str):
    """HTML that is safe already. Any other string is text, and is escaped where it enters an element."""

    __slots__ = ()


Child = str | None | Iterable["Child"]


def fragment(*children: Child) -> Markup:
    """The children side by side, text escaped; None leaves nothing."""
    parts: list[str] = []
    for child in children:
        if child is None:
            continue
        if isinstance(child, Markup):
            parts.append(child)
        elif isinstance(child, str):
            parts.append(html.escape(child, quote=True))
        else:
            parts.append(fragment(*child))
    return Markup("".join(parts))


def element(tag: str, *children: Child, **attributes: str | None) -> Markup:
    """``<tag attributes>children</tag>``.

    Attribute names drop a trailing underscore and turn the others into hyphens (``class_``, ``aria_label``); None
    leaves the attribute out. Values are escaped.
    """
    written = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{html.escape(value, quote=True)}"'
        for name, value in attributes.items()
        if value is not None
    )
    opening = f"<{tag}{written}>"
    return Markup(opening) if tag in VOID else Markup(f"{opening}{fragment(*children)}</{tag}>")


def sentence_list(sentences: Iterable[Child], class_: str | None = None) -> Markup:
    """A list with one item per sentence."""
    return element("ul", [element("li", item) for item in sentences], class_=class_)


def table(
    caption: Child,
    header: Sequence[Child],
    rows: Iterable[Sequence[Child]],
    *,
    highlight: int | None = None,
    class_: str = "",
) -> Markup:
    """A table that scrolls sideways on a narrow screen: first column names the row, ``highlight`` marks a column."""

    def mark(index: int) -> str | None:
        return "best" if index == highlight else None

    head = element("tr", [element("th", cell, scope="col", class_=mark(i)) for i, cell in enumerate(header)])
    body = [
        element(
            "tr",
            element("th", row[0], scope="row"),
            [element("td", cell, class_=mark(i)) for i, cell in enumerate(row[1:], start=1)],
        )
        for row in rows
    ]
    content = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", head),
        element("tbody", body),
        class_=class_ or None,
    )
    name = caption if isinstance(caption, str) and not isinstance(caption, Markup) else "Table"
    return element("div", content, class_="scroll", role="region", tabindex="0", aria_label=name)


def definition_list(pairs: Iterable[tuple[Child, Child]]) -> Markup:
    """Terms with what they stand for."""
    return element("dl", [element("div", element("dt", term), element("dd", value)) for term, value in pairs])
