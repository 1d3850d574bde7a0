"""Pages that show what is measured, and are kept: compared with it, or written anew."""

import os


def compare_or_refresh(page, shown, made):
    """Check that a page shows what is made; with `REFRESH_DOCS` write it into the page instead."""
    if os.environ.get("REFRESH_DOCS"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace(shown, made), encoding="utf-8")
    else:
        assert shown == made


def compare_between(page, begin, end, made):
    """Do that with the part of a page between two marks, which blank lines set apart."""
    text = page.read_text(encoding="utf-8")
    first = text.index(begin)
    compare_or_refresh(page, text[first : text.index(end, first)], f"{begin}\n\n{made.strip()}\n\n")
