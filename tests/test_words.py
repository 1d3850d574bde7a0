"""Pages, docstrings and comments are plain technical English, and docstrings can be read alone."""

import ast
import importlib
import io
import re
import tokenize
from pathlib import Path

import pyphen

import auv_gym

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
LEANING = re.compile(
    r"\blikewise\b|\bthe same as above\b|\b(see|as) above\b|, as the (next|previous|former|last)\b"
    r"|\bas the (next|previous|last) (one|two|three|four|five|six)\b|^As `?\w+`?\.$|^See the (next|previous)",
    re.IGNORECASE | re.MULTILINE,
)
"""Words by which a docstring leans on one of its neighbours."""
PLAIN = {"FOLDER", "PROGRAM", "T"}
"""Constants that their names explain: a module's folder of data, its command, a type variable."""
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


def test_docstrings_and_comments_stand_alone():
    texts = [(path, line, text) for path in CODE for line, text in said(path)]
    assert [f"{path}:{line}: {match[0]}" for path, line, text in texts if (match := LEANING.search(text))] == []


def undocumented(path):
    """Return the public constants of a module without a docstring and a comment at the end of their line."""
    text = path.read_text(encoding="utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
            has_docstring = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if not has_docstring and "# " not in lines[node.lineno - 1] + lines[node.end_lineno - 1]:
                yield from (name for name in names - PLAIN if re.fullmatch(r"[A-Z][A-Z0-9_]*", name))


def test_constants_of_the_package_are_explained():
    files = [path for path in CODE if path.relative_to(ROOT).parts[0] in ("auv_gym", "baselines")]
    assert {path: names for path in files if (names := [*undocumented(path)])} == {}


def test_public_attributes_have_help():
    for name in auv_gym.__all__:
        assert name in vars(importlib.import_module(f"auv_gym.{auv_gym._HOMES[name]}"))
        assert getattr(auv_gym, name).__doc__
