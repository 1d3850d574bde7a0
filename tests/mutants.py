"""Changes the source code at random places and checks that tests notice it (mutation testing).

`python tests/mutants.py [--count N] [--seed S]` changes one operator, number, condition or function in a copy of the
repository, and runs tests of the changed module: those that import it, then all of its package, then slow ones. A
change that no test notices survives. The exit status is 1 if tests notice less than `LEAST` of the changes that are
not in `EQUIVALENT`. At first all tests must pass with a change that has no effect.
"""

import argparse
import ast
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE = 900  # [s] time limit of one run of tests; a change that exceeds it counts as noticed
LEAST = 0.9  # share of the changes that tests must notice
WIDTH = 30  # characters before and after a change that are shown
MODULES = {
    "auv_gym/physics": "dynamics errors actuators navigation steering wind stiffness vehicle disturbances",
    "auv_gym/planning": "planner sideslip crossed feasibility kernels",
    "auv_gym/task": "simulation observation kernels preview",
    "auv_gym/codegen": "*",
    "baselines/control": "backstepping",
    "baselines/evaluation": "score metrics",
}
"""The modules that are changed, by folder."""
UNFIT = ("scores_of_files", "page_is_that_of_the_command", "own_entries", "default_request")
"""Parts of names of tests that fail after any change, since they compare a hash of the source code."""
EQUIVALENT = {
    "auv_gym/codegen/elementary.py: t = above / ns.where(below > 0.0, below, ns.where(below <= 0"
    " -> t = above / ns.where(below > 1.0, below, ns.where(below <= 0": "the other branch selects the same number",
    "auv_gym/codegen/graph.py: return symbols[0].graph.constant(0.0)"
    " -> return symbols[1].graph.constant(0.0)": "both are symbols of one graph",
    "auv_gym/task/observation.py: t (-far < e_x < far and -far < e_y < far and (-V < u_e < V)"
    " -> t (-far < e_x < far and -far <= e_y < far and (-V < u_e < V)": "a number at its bound is clipped to itself",
    "auv_gym/codegen/blocks.py: items()} | {'kept': max(kept, 1)}"
    " -> items()} | {'kept': max(kept, 2)}": "a row of memory that is not used",
    "auv_gym/codegen/native.py: if sys.platform == 'darwin':"
    " -> if sys.platform != 'darwin':": "Linux has no sysctl of macOS, so that both read /proc/cpuinfo",
}
"""Changes that no test can notice: file and change as they are printed, and the reason."""
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
PAIRS = ("min max", "minimum maximum", "fmin fmax", "sin cos", "floor ceil", "any all", "argmin argmax")
FUNCTIONS = {a: b for pair in PAIRS for a, b in (pair.split(), pair.split()[::-1])}


@dataclass(frozen=True)
class Mutant:
    """A change of a file: the number of a node in its syntax tree, and of one of the node's variations."""

    file: str
    node: int
    variation: int


def variations(node, annotation):
    """Return the changes of a node, each as a field and its new value; of annotations only the numbers."""
    if isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
        return [("value", not node.value if isinstance(node.value, bool) else node.value + 1)]
    if annotation:
        return []
    if isinstance(node, ast.Compare):
        ops = node.ops
        return [("ops", [*ops[:k], new(), *ops[k + 1 :]]) for k, op in enumerate(ops) for new in COMPARISONS[type(op)]]
    if isinstance(node, (ast.BinOp, ast.AugAssign, ast.BoolOp)) and type(node.op) in OPERATORS:
        return [("op", OPERATORS[type(node.op)]())]
    if isinstance(node, ast.UnaryOp):
        return [("operand", ast.UnaryOp(node.op, node.operand))]  # twice, which undoes it
    for name in ("attr", "id"):
        if (new := FUNCTIONS.get(getattr(node, name, None))) is not None:
            return [(name, new)]
    return []


def nodes(tree):
    """Return the nodes of a tree and whether they are in an annotation, without decorators and `strict` of `zip`."""
    found, stack = [], [(tree, False)]
    while stack:
        node, annotation = stack.pop()
        found.append((node, annotation))
        for name, value in ast.iter_fields(node):
            if name != "decorator_list" and getattr(node, "arg", None) != "strict":
                parts = value if isinstance(value, list) else [value]
                inside = annotation or name in ("annotation", "returns")
                stack += [(part, inside) for part in parts if isinstance(part, ast.AST)]
    return found


def mutants():
    """Return all possible changes."""
    patterns = [f"{folder}/{name}.py" for folder, names in MODULES.items() for name in names.split()]
    files = [file for pattern in patterns for file in sorted(ROOT.glob(pattern))]
    return [
        Mutant(str(file.relative_to(ROOT)), i, j)
        for file in files
        for i, (node, annotation) in enumerate(nodes(ast.parse(file.read_text(encoding="utf-8"))))
        for j in range(len(variations(node, annotation)))
    ]


def same(a, b):
    """Return the length of the common beginning of two texts."""
    return next((k for k, pair in enumerate(zip(a, b, strict=False)) if len({*pair}) > 1), min(len(a), len(b)))


def changed(mutant):
    """Return the changed source, the number of the line, and the change as text."""
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    before = ast.unparse(tree)
    node, annotation = nodes(tree)[mutant.node]
    setattr(node, *variations(node, annotation)[mutant.variation])
    after = ast.unparse(tree)
    old, new = next(lines for lines in zip(before.splitlines(), after.splitlines(), strict=True) if len({*lines}) > 1)
    first = same(old, new)
    last = min(same(old[::-1], new[::-1]), len(old) - first, len(new) - first)
    shown = [text[max(first - WIDTH, 0) : len(text) - last + WIDTH].strip() for text in (old, new)]
    return after, node.lineno, " -> ".join(shown)


def tests_of(file, folder):
    """Return the arguments of pytest for one run after the other."""
    package, _, module = file.removesuffix(".py").replace("/", ".").rpartition(".")
    imports = re.compile(rf"\b{package}\.{module}\b|from {package} import .*\b{module}\b")
    whole = [test for room in ("auv_gym", "baselines") for test in sorted((folder / "tests" / room).glob("test_*.py"))]
    near = [test for test in whole if test.stem == f"test_{module}" or imports.search(test.read_text(encoding="utf-8"))]
    near.sort(key=lambda test: test.stem != f"test_{module}")
    rest = [test for test in whole if test not in near and test.parent.name == file.split("/")[0]]
    return [[*part, "-m", mark] for part, mark in ((near, "not slow"), (rest, "not slow"), (near, "slow")) if part]


def failure(folder, words):
    """Return the first test that fails in a folder with a copy of the repository; "" if all pass."""
    with (
        tempfile.TemporaryDirectory(dir=folder.parent, ignore_cleanup_errors=True) as own,
        Path(own, "out").open("w+", encoding="utf-8") as out,
    ):
        cache = Path(shutil.copytree(folder.parent / "cache", Path(own) / "cache", copy_function=os.link))
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        unfit = " and ".join(f"not {name}" for name in UNFIT)
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-qx", "-p", "no:cacheprovider", "-k", unfit, *words],
            cwd=folder,
            env=os.environ
            | threads
            | {"PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(cache), "AUV_GYM_CACHE": "", "TMPDIR": own},
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            status = process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            return "time limit"
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        out.seek(0)
        lines = out.read().splitlines() or [""]
        failed = [line.split()[1] for line in lines if line.startswith(("FAILED ", "ERROR "))]
        return "" if status in (0, 5) else (failed or lines[-1:])[0]  # 5: no test is selected


def copied(folder):
    """Copy the repository and the compiled code of this user to a folder; return the former's place."""
    from auv_gym.codegen.cache import cache_folders

    listed = subprocess.check_output(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, text=True)
    for name in listed.splitlines():
        if (ROOT / name).is_file():
            (folder / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / "copy" / name)
    (folder / "cache").mkdir()
    if (own := next(cache_folders())).is_dir():
        shutil.copytree(own, folder / "cache" / "auv_gym", ignore=shutil.ignore_patterns("build-*"))
    return folder / "copy"


def main():
    """Try random changes, print each one, and the share that was noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    every = mutants()
    drawn = random.Random(options.seed).sample(every, options.count)
    counts = dict.fromkeys(("killed", "equivalent", "survived"), 0)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = copied(Path(name))
        files = sorted({mutant.file for mutant in drawn})
        for file in files:
            (folder / file).write_text((ROOT / file).read_text(encoding="utf-8") + "\n_ = None\n", encoding="utf-8")
        if wrong := failure(folder, ["tests/auv_gym", "tests/baselines", "-m", "not slow"]):
            sys.exit(f"a test fails after a change without effect: {wrong}")
        for file in files:
            shutil.copy2(ROOT / file, folder / file)
        for mutant in drawn:
            text, line, change = changed(mutant)
            file, begin, by = folder / mutant.file, time.monotonic(), ""
            file.write_text(text, encoding="utf-8")
            if f"{mutant.file}: {change}" in EQUIVALENT:
                end = "equivalent"
            else:
                by = next(filter(None, (failure(folder, words) for words in tests_of(mutant.file, folder))), "")
                end = "killed" if by else "survived"
            shutil.copy2(ROOT / mutant.file, file)
            counts[end] += 1
            print(
                f"{end}, {time.monotonic() - begin:.0f} s, {mutant.file}:{line}: {change}", by and f"({by})", flush=True
            )
    print(f"{len(drawn)} of {len(every)} changes: {', '.join(f'{count} {end}' for end, count in counts.items())}")
    share = counts["killed"] / max(len(drawn) - counts["equivalent"], 1)
    print(f"noticed of those that are not equivalent: {share:.0%}")
    sys.exit(share < LEAST)


if __name__ == "__main__":
    main()
