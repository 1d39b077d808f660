"""A document of headings, paragraphs, tables and figures, written as Markdown and as one self-contained HTML page."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uwoc_gym.agents.reports.tables import grid


@dataclass(frozen=True)
class Heading:
    """A heading of level 1 to 3."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True)
class Table:
    """Cells as text, one header row, and a caption."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str


@dataclass(frozen=True)
class Picture:
    """A figure that stands as NAME.png and NAME.svg beside the document."""

    name: str
    caption: str


Block = Heading | Paragraph | Table | Picture

_STYLE = """
:root { color-scheme: light dark; --line: #8886; --soft: #8881; }
body { font: 16px/1.55 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1, h2, h3 { line-height: 1.25; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 0.9rem; }
div.wide { overflow-x: auto; } th, td { padding: 0.3rem 0.7rem; border-bottom: 1px solid var(--line); }
th { text-align: left; background: var(--soft); } td + td { text-align: right; }
figure { margin: 1.5rem 0; } img { width: 100%; height: auto; background: white; border-radius: 6px; }
figcaption, caption { font-size: 0.9rem; opacity: 0.8; text-align: left; caption-side: bottom; padding-top: 0.4rem; }
"""


def markdown(blocks: Sequence[Block]) -> str:
    """The document as Markdown, which refers to the figures' PNG files."""
    return "\n\n".join(_markdown(block) for block in blocks) + "\n"


def _markdown(block: Block) -> str:
    match block:
        case Heading():
            return f"{'#' * block.level} {block.text}"
        case Paragraph():
            return block.text
        case Table():
            return f"{grid(block.header, block.rows)}\n\n*{block.caption}*"
        case Picture():
            return f"![{block.caption}]({block.name}.png)\n\n*{block.caption}*"


def page(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """The document as HTML that opens offline, with the figures' SVG files from ``folder`` in it."""
    body = "\n".join(_html(block, folder) for block in blocks)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{html.escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def _html(block: Block, folder: Path) -> str:
    match block:
        case Heading():
            return f"<h{block.level}>{html.escape(block.text)}</h{block.level}>"
        case Paragraph():
            return f"<p>{html.escape(block.text)}</p>"
        case Table():
            head = "".join(f"<th>{html.escape(cell)}</th>" for cell in block.header)
            rows = "\n".join(
                "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in block.rows
            )
            caption = html.escape(block.caption)
            return (
                f'<div class="wide"><table>\n<caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n'
                f"<tbody>\n{rows}\n</tbody></table></div>"
            )
        case Picture():
            # An <img> keeps the ids of one SVG from clashing with those of the next.
            data = base64.b64encode((folder / f"{block.name}.svg").read_bytes()).decode("ascii")
            caption = html.escape(block.caption)
            return (
                f'<figure><img alt="{caption}" src="data:image/svg+xml;base64,{data}">'
                f"<figcaption>{caption}</figcaption></figure>"
            )
