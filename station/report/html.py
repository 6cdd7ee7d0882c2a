"""HTML that cannot be broken by what it shows: text is escaped where it goes in, and only `Html` goes in as it is."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from station.printable import printable

_LONGEST = 2000  # characters of a text from outside
_VOID = frozenset(("br", "img", "meta"))


class Html(str):
    """Markup that was made here; any other string is text."""

    __slots__ = ()


Child: TypeAlias = "str | Iterable[Child] | None"


def tag(name: str, /, *children: Child, **attributes: str | int | float | None) -> Html:
    """Return an element.

    Args:
        name: Its name.
        children: Text, which is escaped, or `Html`, or lists of these; None for nothing.
        attributes: Escaped; ``class_`` for class, underscores for dashes; one that is None is left out.
    """
    named = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_escaped(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _VOID:
        return Html(f"<{name}{named}>")
    return Html(f"<{name}{named}>{join(children)}</{name}>")


def join(children: Iterable[Child]) -> Html:
    """Return children one after the other."""
    return Html("".join(_one(child) for child in children))


def table(head: Sequence[Child], rows: Iterable[Sequence[Child]], *, class_: str = "") -> Html:
    """Return a table in a box that scrolls where it is too wide."""
    titles = tag("tr", [tag("th", title) for title in head])
    body = [tag("tr", [tag("td", cell) for cell in row]) for row in rows]
    return tag("div", tag("table", tag("thead", titles), tag("tbody", body), class_=class_ or None), class_="scroll")


def details(summary: Child, *children: Child) -> Html:
    """Return something that is folded until it is asked for."""
    return tag("details", tag("summary", summary), *children)


def picture(data: bytes, kind: str, alt: str, *, class_: str | None = None) -> Html:
    """Return an image that is part of the page; `kind` is ``png`` or ``jpeg``."""
    named = "" if class_ is None else f' class="{_escaped(class_)}"'
    encoded = base64.b64encode(data).decode()
    return Html(f'<img src="data:image/{kind};base64,{encoded}" alt="{_escaped(alt)}"{named}>')


def _one(child: Child) -> str:
    if child is None:
        return ""
    if isinstance(child, Html):
        return child
    return _escaped(child) if isinstance(child, str) else join(child)


def _escaped(text: str) -> str:
    return html.escape(printable(text, _LONGEST), quote=True)
