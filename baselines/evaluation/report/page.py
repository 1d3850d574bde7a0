"""A page that opens from disk: its frame, its tables and its figures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from string import Template

_FRAME = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1240px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; font-size: 0.87em; font-variant-numeric: tabular-nums; }
th, td { padding: 0.15em 0.7em; text-align: right; white-space: nowrap; }
th { border-bottom: 2px solid #888; } td.name, th.name { text-align: left; }
tr.first td { border-top: 1px solid #ccc; }
.wide { overflow-x: auto; } img { max-width: 100%; } figure { margin: 1.5em 0; }
figcaption, .note { color: #555; font-size: 0.9em; } code { background: #f3f3f3; padding: 0.1em 0.3em; }
dt { font-weight: 600; } dd { margin: 0 0 0.5em 1.5em; } .failed { color: #b00; }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def page(title: str, body: str) -> str:
    """Return the text of a page; the body is HTML."""
    return _FRAME.substitute(title=escape(title), body=body)


def figure(caption: str, png: bytes) -> str:
    """Return a figure with its picture inside."""
    data = base64.b64encode(png).decode("ascii")
    image = f'<img src="data:image/png;base64,{data}" alt="{escape(caption)}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def table(names: Sequence[str], rows: Sequence[tuple[bool, Sequence[str]]], left: int = 1) -> str:
    """Return a table; each row says whether a group begins with it; the first `left` columns are names."""

    def line(cells: Sequence[str], tag: str, first: bool) -> str:
        kinds = [' class="name"' if i < left else "" for i in range(len(cells))]
        body = "".join(f"<{tag}{kind}>{escape(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=True))
        return f'<tr class="first">{body}</tr>' if first else f"<tr>{body}</tr>"

    body = "\n".join(line(cells, "td", first) for first, cells in rows)
    return f"<table>\n{line(names, 'th', False)}\n{body}\n</table>"
