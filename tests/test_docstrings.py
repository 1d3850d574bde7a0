"""A newcomer's check: every public docstring can be read alone, in `help()`, and each constant has its own."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(p for room in ("auv_gym", "baselines") for p in (ROOT / room).rglob("*.py"))
LEANING = re.compile(
    r"\blikewise\b|\bthe same as above\b|\bsee above\b|\bas above\b|, as the (next|previous|former|last)\b"
    r"|\bas the (next|previous|last) (one|two|three|four|five|six)\b|^As `?\w+`?\.$|^See the (next|previous)",
    re.IGNORECASE | re.MULTILINE,
)
"""Words by which a docstring leans on one of its neighbours."""
PLAIN = {"FOLDER", "PROGRAM", "T"}
"""Constants that their names explain: a module's folder of data, its command, a type variable."""


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def documented(tree, prefix=""):
    """Yield name and docstring, None if there is none, of a module's or class's public names, constants included."""
    body = tree.body
    for node, following in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            yield prefix + node.name, ast.get_docstring(node)
            if isinstance(node, ast.ClassDef):
                yield from documented(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.Assign | ast.AnnAssign) and not prefix:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [t for target in targets for t in (target.elts if isinstance(target, ast.Tuple) else [target])]
            text = following.value.value if is_text(following) else None
            for target in names:
                if isinstance(target, ast.Name) and re.fullmatch(r"[A-Z][A-Z0-9_]*", target.id):
                    yield prefix + target.id, text if len(names) == 1 else None


def fields(tree, lines):
    """Yield the fields of a module's classes with the comments at the end of their lines."""
    for node in tree.body:
        for field in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                yield f"{node.name}.{field.target.id}", lines[field.end_lineno - 1].partition("  # ")[2]


def is_text(node):
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def offenders(path):
    """Return the public names of a file whose docstring is missing or leans on others, and why."""
    text = path.read_text(encoding="utf-8")
    lines, found = text.splitlines(), {}
    tree = ast.parse(text)
    texts = [("", ast.get_docstring(tree)), *documented(tree), *fields(tree, lines)]
    for name, docstring in texts:
        if docstring and (match := LEANING.search(docstring)):
            found[name] = f"leans on others: {match[0]!r}"
        elif not docstring and name.isupper() and name not in PLAIN and not explained(name, tree, lines):
            found[name] = "has no docstring, and no comment at the end of its line"
    return found


def explained(name, tree, lines):
    """Return whether a constant stands alone in its line, with a comment at its end."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            return "# " in lines[node.end_lineno - 1] or "# " in lines[node.lineno - 1]
    return False


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_docstrings_stand_alone(path):
    assert not offenders(path)


def test_public_attributes_have_help():
    import auv_gym

    for name in auv_gym.__all__:
        value = getattr(auv_gym, name)
        home = importlib.import_module(f"auv_gym.{auv_gym._HOMES[name]}")
        assert name in vars(home)
        assert value.__doc__
