"""A newcomer's check: every public docstring can be read alone, in `help()`, and each constant has its own."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(p for room in ("auv_gym", "baselines", "benchmarks") for p in (ROOT / room).rglob("*.py"))
LEANING = re.compile(
    r"\blikewise\b|\bthe same as above\b|\bsee above\b|\bas above\b|, as the (next|previous|former|last)\b"
    r"|\bas the (next|previous|last) (one|two|three|four|five|six)\b|^As `?\w+`?\.$|^See the (next|previous)",
    re.IGNORECASE | re.MULTILINE,
)
"""Words by which a docstring leans on one of its neighbours."""
PLAIN = {"FOLDER", "PROGRAM", "T"}
"""Constants that their names explain: a module's folder of data, its command, a type variable."""
TO_MEND: dict[str, set[str]] = {
    "baselines/__init__.py": {"make_residual_env", "make_residual_vector_env"},
    "baselines/agents/agent.py": {"CARD", "ENTRIES", "OBSERVATION_LAYOUT", "RECORD", "WEIGHTS"},
    "baselines/agents/features.py": {"FAST", "FEATURES", "SLOW"},
    "baselines/agents/model_card.py": {"CURVE"},
    "baselines/agents/networks.py": {"ACTIONS", "ACTIVATIONS"},
    "baselines/control/current_observer.py": {"LAW"},
    "baselines/control/ekf_law.py": {"FILTER", "LAW"},
    "baselines/control/integral.py": {"LAW"},
    "baselines/control/los_pid.py": {"PIDGains.horizon"},
    "baselines/control/lqi.py": {"FORCES", "SPEEDS", "STATES", "Weights.horizon"},
    "baselines/control/nmpc/controller.py": {"FIRST_STEPS", "LAW", "STEPS"},
    "baselines/control/nmpc/gauss_newton.py": {"NEGLIGIBLE", "TOLERANCE"},
    "baselines/control/nmpc/problem.py": {"COMMANDS", "FORCE", "STATES", "SWAY"},
    "baselines/control/oracle.py": {"BLIND"},
    "baselines/estimation/kalman.py": {
        "FIRST_BIAS",
        "FIRST_CURRENT",
        "FIRST_LAG",
        "FIRST_POSE",
        "FIRST_SURGE",
        "FIRST_SWAY",
        "FIRST_TURN",
        "FORCE_DRIFT",
        "HULL_DRIFT",
        "LAG_DRIFT",
    },
    "baselines/estimation/sea_model.py": {
        "BIAS",
        "BIAS_MEMORY",
        "CURRENT",
        "CURRENT_MEMORY",
        "FORCE",
        "GUST",
        "GUST_MEMORY",
        "HULL",
        "LAG",
        "LONGEST_LAG",
        "SENSORS",
        "SHORTEST_LAG",
        "SIZE",
        "WAVES",
    },
    "baselines/estimation/water_frame.py": {""},
    "baselines/evaluation/paper/noise_study.py": {"SEEDS"},
    "baselines/evaluation/paper/numbers.py": {"PAPER_GAINS"},
    "baselines/evaluation/report/figures.py": {"DRAWN"},
    "baselines/evaluation/report/html.py": {"BODY", "CAPTIONS", "DEFINITIONS"},
    "baselines/evaluation/report/page.py": {"FRAME"},
    "baselines/evaluation/report/plots.py": {"COLUMNS", "LEGEND"},
    "baselines/evaluation/report/terminal.py": {"LOOK"},
    "baselines/evaluation/request.py": {"DEFAULT_EPISODES", "DEFAULT_SUITE"},
    "baselines/evaluation/results/collection.py": {"Results.tails"},
    "baselines/evaluation/results/studies.py": {"NAMES"},
    "baselines/evaluation/rollout.py": {"ENV_ID"},
    "baselines/evaluation/score.py": {"EXPERT", "ORACLE"},
    "baselines/evaluation/stability/certificate.py": {"BOXES", "COARSE", "FINE", "MISSING"},
    "baselines/evaluation/stability/report.py": {"STEPS"},
    "baselines/evaluation/study_files.py": {"InSuite.effort", "InSuite.lost"},
    "baselines/evaluation/suites/__init__.py": {"FORMAT", "SUMS"},
    "baselines/evaluation/suites/builder.py": {
        "EPISODES",
        "FARTHER",
        "OUTAGES",
        "OUTAGE_TIME",
        "RAMP",
        "SHEAR",
        "SLUGGISH",
        "STRONGER",
        "UNMODELLED_EPISODES",
        "VALIDATION_EPISODES",
        "WAVELENGTHS",
    },
    "baselines/tools/command_line.py": {"DONE", "FAILED", "WRONG_USAGE"},
    "baselines/tools/figure_style.py": {"MARKERS"},
    "baselines/training/apg/closed_loop.py": {"CURVE", "NEAR"},
    "baselines/training/apg/trainer.py": {"Settings.rate_weight"},
    "baselines/training/command.py": {"CURVE"},
    "baselines/training/config.py": {"LARGEST_SEED"},
    "baselines/training/hyperparameters/__init__.py": {"ENV_ID"},
    "baselines/training/mixtures.py": {"ADVERSE_WEIGHT", "OUTAGE_TIMES", "WAVELENGTHS"},
    "baselines/training/request.py": {"DEFAULT_AUTHORITY", "DEFAULT_TIMESTEPS"},
    "baselines/training/run_folder.py": {"AGENT", "CHECKPOINT", "CONFIG", "EVENTS", "PROGRESS"},
    "baselines/training/sb3/trainer.py": {"CALLBACKS", "MODELS", "NOISES", "WRAPPERS"},
    "baselines/training/study/command.py": {"FEW", "SHORT"},
    "baselines/training/validation.py": {"SUITE"},
    "baselines/tuning/search.py": {"CRUISE_LAW", "INTEGRAL", "LAW", "NORMALISED", "TUNING_SEED", "VALIDATION_EPISODES"},
}
"""Names whose docstrings are still to be mended, by file; none may be added."""


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
    found, known = offenders(path), TO_MEND.get(name_of(path), set())
    assert set(found) <= known, {name: why for name, why in found.items() if name not in known}
    assert known <= set(found), f"mended, so take from TO_MEND: {sorted(known - set(found))}"


def test_public_modules_say_what_they_are():
    for path in FILES:
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path


def test_public_attributes_have_help():
    import auv_gym

    for name in auv_gym.__all__:
        value = getattr(auv_gym, name)
        home = importlib.import_module(f"auv_gym.{auv_gym._HOMES[name]}")
        assert name in vars(home)
        assert value.__doc__
