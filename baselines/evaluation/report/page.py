"""A page that opens from disk: a template, its style, scripts and charts, and all of its data in one file.

Vega-Lite draws the charts. Its code comes from vl-convert, once for all charts of a page, and lies in it compressed, as
the data do; the browser unpacks both. Text goes through Jinja2's escaping, data through JSON: names are users' own.
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

from auv_gym.codegen.cache import cache_folders, open_own, own_folder
from auv_gym.installation import install
from baselines.tools.files import finite, write_atomically

WEB = Path(__file__).parent / "web"
"""The templates, the style and the scripts."""
_MISSING = f"pages need Jinja2 and vl-convert: {install('eval')}"  # said where they are not there
_WORST, _MIDDLE, _BEST = (217, 128, 50), (250, 250, 248), (60, 130, 190)  # colours of -1, 0 and 1
_SNIPPET = "window.vegaEmbed = vegaEmbed;"  # what the pages need of the library


def render_report(template: str, data: Any, scripts: tuple[str, ...] = (), **context: Any) -> str:
    """Return the text of a page.

    Args:
        template: name of a file in `WEB`.
        data: what the scripts read, plain JSON; null in place of numbers that are not finite.
        scripts: names of the files in `WEB` that this page has besides `page.js`.
        context: what the template needs; text in it is escaped.

    Raises:
        ImportError: a library is missing; the message says which extra has it.
    """
    try:
        import jinja2
    except ImportError as error:
        raise ImportError(_MISSING) from error
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(template).render(
        style=_own("page.css"),
        script="\n".join(_own(name) for name in ("page.js", *scripts)),
        library=_library(),
        data=_packed(json.dumps(finite(data), separators=(",", ":"), allow_nan=False)),
        **context,
    )


def mixed(share: float) -> str:
    """Return the colour of a value in [-1, 1], what is beyond cut: orange, white, blue, which all eyes tell apart."""
    share = min(max(share, -1.0), 1.0)
    end = _BEST if share > 0 else _WORST
    return "#{:02x}{:02x}{:02x}".format(*(round(a + (b - a) * abs(share)) for a, b in zip(_MIDDLE, end, strict=True)))


def _packed(text: str) -> str:
    """Return a text compressed, in characters that mean nothing to HTML; the same text gives the same characters."""
    return base64.b64encode(gzip.compress(text.encode(errors="backslashreplace"), mtime=0)).decode("ascii")


def _own(name: str) -> str:
    """Return a file of `WEB`, as it stands on the page."""
    return (WEB / name).read_text(encoding="utf-8")


@cache
def _library() -> str:
    """Return the code that draws charts, packed; it is made once and kept, since that takes seconds.

    Raises:
        ImportError: the library is missing.
    """
    try:
        import vl_convert
    except ImportError as error:
        raise ImportError(_MISSING) from error
    version = f"{metadata.version('vl-convert-python')} {_SNIPPET}"
    name = f"charts-{hashlib.sha256(version.encode()).hexdigest()[:16]}.txt"
    for folder in cache_folders():
        with suppress(OSError, ValueError, EOFError, zlib.error), open_own(folder / name) as file:
            code = file.read().decode("ascii")  # else it is not there, damaged, or not this user's
            gzip.decompress(base64.b64decode(code))
            return code
    code = _packed(vl_convert.javascript_bundle(_SNIPPET))
    for folder in cache_folders():
        with suppress(OSError):  # it is made again the next time
            write_atomically(own_folder(folder) / name, code)
            (folder / name).chmod(0o644)  # no umask lets others write
            break
    return code
