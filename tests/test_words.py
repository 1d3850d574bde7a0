"""Pages, docstrings and comments are plain technical English: no private words, and sentences that are easy to read."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pyphen

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")]
    + [*(ROOT / "docs").rglob("*.md"), *(ROOT / "research" / "templates").rglob("*.jinja")]
)
CODE = sorted(p for room in ("auv_gym", "baselines", "research", "examples") for p in (ROOT / room).rglob("*.py"))
GLOSSARY = ROOT / "docs" / "glossary.md"
HARDEST = 9.0
"""Largest Flesch-Kincaid grade of a page: the ninth year of school."""
PRIVATE = re.compile(
    r"\b(told|whom|whoever|as told|nobody|everybody|anybody|somebody|anew|hulls?|crews?|fleet|voyages?|kin"
    r"|tape|lanes?|regimes?|seas|clairvoyan\w*|what comes of|what is left|behind it|but for|house|rooms?|film(s|ed)?"
    r"|lost|tails?|yardsticks?)\b",
    re.IGNORECASE,
)
"""Words that had a meaning in this project alone, or personify software; docs/glossary.md has the standard terms."""
SYLLABLES = pyphen.Pyphen(lang="en_US")


def prose(text):
    """Return the sentences of a page: no code, tables, links, formulas, headings and marks."""
    for pattern, by in (
        (r"\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}|<!--.*?-->|```.*?```|\$\$.*?\$\$", " "),
        (r"^(:{3,}.*|:[\w-]+:.*|\|.*\||#+ .*|---.*)$", " "),
        (r"!?\[([^\]]*)\]\([^)]*\)", r"\1"),
        (r"`[^`]*`|\$[^$]*\$|https?:\S+", "x"),
        (r"^\s*([-*]|\d+\.) ", ". "),
        (r"[*_>|]", " "),
    ):
        text = re.sub(pattern, by, text, flags=re.DOTALL if by == " " and "```" in pattern else re.MULTILINE)
    return text


def grade(text):
    """Return the Flesch-Kincaid grade of a text (Kincaid et al., Research Branch Report 8-75, 1975)."""
    sentences = [s for s in re.split(r"[.!?:;](?:\s|$)|\n\s*\n", text) if len(s.split()) > 2]
    words = [w for s in sentences for w in re.findall(r"[A-Za-z][A-Za-z'-]*", s)]
    syllables = sum(len(SYLLABLES.positions(word)) + 1 for word in words)
    return 0.39 * len(words) / len(sentences) + 11.8 * syllables / len(words) - 15.59


def said(path):
    """Return the docstrings and comments of a module, with their lines."""
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def test_pages_are_easy_to_read():
    texts = {page.relative_to(ROOT): prose(page.read_text(encoding="utf-8")) for page in PAGES}
    grades = {page: round(grade(text), 1) for page, text in texts.items() if len(text.split()) > 60}
    assert {page: value for page, value in grades.items() if value > HARDEST} == {}
    assert len(grades) > 40


def test_pages_have_no_private_words():
    found = {page: PRIVATE.findall(prose(page.read_text(encoding="utf-8"))) for page in PAGES if page != GLOSSARY}
    assert {page: words for page, words in found.items() if words} == {}


def test_docstrings_and_comments_have_no_private_words():
    texts = ((path, line, re.sub(r"`[^`]*`", "x", text)) for path in CODE for line, text in said(path))
    assert [f"{path}:{line}: {match[0]}" for path, line, text in texts if (match := PRIVATE.search(text))] == []
