"""A self-contained HTML page: figures, tables, words. Nothing is fetched; every text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from tuning.report.style import svg_of


def page(title: str, sections: Sequence[str]) -> str:
    """The whole document."""
    css = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
    # No source of anything but this file: the browser itself holds the page to being self-contained.
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        f"<title>{escape(title)}</title><style>{css}</style></head>\n<body><main><h1>{escape(title)}</h1>\n"
        + "\n".join(sections)
        + "\n</main></body></html>\n"
    )


def section(heading: str, *parts: str) -> str:
    """A section; parts are HTML."""
    return f"<section><h2>{escape(heading)}</h2>\n" + "\n".join(part for part in parts if part) + "</section>"


def words(text: str, *, quiet: bool = False) -> str:
    """A paragraph; what stands between backticks is to be typed."""
    parts = [f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(escape(text).split("`"))]
    return f"<p{' class=quiet' if quiet else ''}>{''.join(parts)}</p>"


def table(headings: Sequence[str], rows: Sequence[Sequence[object]], caption: str, *, texts: int = 1) -> str:
    """A table whose first `texts` columns are texts; the first names its row."""

    def cell(tag: str, column: int, value: object) -> str:
        scope = ' scope="col"' if tag == "th" else ""
        return f"<{tag}{scope}{' class=text' if column < texts else ''}>{escape(str(value))}</{tag}>"

    head = "".join(cell("th", i, heading) for i, heading in enumerate(headings))
    body = "".join(f"<tr>{''.join(cell('td', i, value) for i, value in enumerate(row))}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><caption><span>{escape(caption)}</span></caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def figures(*drawn: tuple[Figure, str]) -> str:
    """Figures with what they show, in words: also what is read where they cannot be seen."""
    return '<div class="figures">' + "".join(_figure(figure, text) for figure, text in drawn) + "</div>"


def _figure(figure: Figure, text: str) -> str:
    data = base64.b64encode(svg_of(figure).encode()).decode()
    title = " ".join(figure.get_suptitle().split())
    alt = escape(f"{title}. {text}", quote=True)
    return (
        f'<figure><div class="scroll" tabindex="0"><img src="data:image/svg+xml;base64,{data}" alt="{alt}"></div>'
        f"<figcaption>{escape(text)}</figcaption></figure>"
    )


def folded(summary: str, inner: str) -> str:
    """Shown on a click."""
    return f"<details><summary>{escape(summary)}</summary>{inner}</details>"
