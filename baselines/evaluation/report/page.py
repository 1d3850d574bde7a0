"""Renders the report as one file: template, style, scripts, charts and data.

Vega-Lite draws the charts. Its code comes from vl-convert. The page has one compressed copy of it, and the compressed
data; the browser decompresses both. Names come from users, so Jinja2 escapes text, and data are JSON.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import zlib
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import jinja2

from auv_gym.codegen.cache import cache_folders, open_own, own_folder
from baselines.tools.files import finite, write_atomically

WEB = Path(__file__).parent / "web"
"""The templates, the style and the scripts."""
_WORST, _MIDDLE, _BEST = (217, 128, 50), (250, 250, 248), (60, 130, 190)  # colours of -1, 0 and 1
_SNIPPET = "window.vegaEmbed = vegaEmbed;"  # the function of the library that pages use


def render_report(data: Any, **context: Any) -> str:
    """Return the text of the report.

    Args:
        data: data of the scripts, plain JSON; numbers that are not finite become null.
        context: variables of the template; text in them is escaped.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("report.html").render(
        style=_web_file("page.css"),
        script="\n".join(_web_file(name) for name in ("page.js", "report.js", "player.js")),
        library=_library(),
        data=_packed(json.dumps(finite(data), separators=(",", ":"), allow_nan=False)),
        **context,
    )


def mixed(share: float) -> str:
    """Return the colour of a value, clipped to [-1, 1], on a scale from orange over white to blue."""
    share = min(max(share, -1.0), 1.0)
    end = _BEST if share > 0 else _WORST
    return "#{:02x}{:02x}{:02x}".format(*(round(a + (b - a) * abs(share)) for a, b in zip(_MIDDLE, end, strict=True)))


def _packed(text: str) -> str:
    """Return a text compressed and encoded as base64; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode(errors="backslashreplace"), mtime=0)).decode("ascii")


def _web_file(name: str) -> str:
    """Return the text of a file in `WEB`."""
    return (WEB / name).read_text(encoding="utf-8")


@cache
def _library() -> str:
    """Return the packed code of the charts' library; it is cached in a file, since making it takes seconds."""
    version = f"{metadata.version('vl-convert-python')} {_SNIPPET}"
    name = f"charts-{hashlib.sha256(version.encode()).hexdigest()[:16]}.txt"
    for folder in cache_folders():
        with suppress(OSError, ValueError, EOFError, zlib.error), open_own(folder / name) as file:
            code = file.read().decode("ascii")  # an exception: it is missing, damaged, or another user's
            gzip.decompress(base64.b64decode(code))
            return code
    import vl_convert

    code = _packed(vl_convert.javascript_bundle(_SNIPPET))
    for folder in cache_folders():
        with suppress(OSError):  # without a cache it is made again the next time
            write_atomically(own_folder(folder) / name, code)
            (folder / name).chmod(0o644)  # not writable for other users, whatever the umask is
            break
    return code
