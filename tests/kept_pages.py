"""Pages that show what is measured, and are kept: compared with it, or written anew."""

import os


def compare_or_refresh(page, shown, made):
    """Check that a page shows what is made; with `REFRESH_DOCS` write it into the page instead."""
    if os.environ.get("REFRESH_DOCS"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace(shown, made), encoding="utf-8")
    else:
        assert shown == made
