"""Builds the package and looks at it: `make package` in full, `tests/test_package.py` what takes seconds of it.

In full: wheel and source distribution in build environments of their own, the wheel that the latter builds compared
with the former, both checked as the index does, and the wheel installed into an empty environment, in which the
README's first lines run in a folder elsewhere.
"""

import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
LARGEST = 3_700_000  # bytes of a wheel
FENCE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LEFT = (".git", ".venv", "build", "dist", "runs", "__pycache__", ".*_cache", ".hypothesis")
"""What a copy of the repository leaves behind."""


def run(*command, cwd):
    """Run a command in a folder and return what it prints; what it says where it fails is shown."""
    done = subprocess.run([str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build(source, out, *options):
    """Build wheel and source distribution of a folder into another and return their files."""
    run(sys.executable, "-m", "build", "--outdir", out, *options, source, cwd=out)
    [wheel], [sdist] = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, sdist


def wheel_of(sdist, out, *options):
    """Return the wheel that a source distribution builds by itself."""
    with tarfile.open(sdist) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # Python before 3.10.12 and 3.11.4 has none
        archive.extractall(out)
    [source] = (folder for folder in out.iterdir() if folder.is_dir())
    run(sys.executable, "-m", "build", "--wheel", "--outdir", out, *options, source, cwd=out)
    [wheel] = out.glob("*.whl")
    return wheel


def contents(wheel):
    """Return what is in each file of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def checked(wheel, sdist, again):
    """Say how large a package is, once it is known that it is small enough, complete and fit for an index."""
    run(sys.executable, "-m", "twine", "check", "--strict", wheel, sdist, cwd=wheel.parent)
    size = wheel.stat().st_size
    assert size <= LARGEST, f"{wheel.name} has {size} bytes, more than {LARGEST}"
    assert contents(wheel) == contents(again), "the source distribution builds another wheel"
    print(f"{wheel.name}: {size / 1e6:.2f} MB of at most {LARGEST / 1e6:g}")
    print(f"{sdist.name}: {sdist.stat().st_size / 1e6:.2f} MB")


def used(wheel, folder):
    """Install a wheel into an empty environment and use it there as the README says, far from any checkout."""
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    python, command = folder / "venv" / "bin" / "python", folder / "venv" / "bin" / "auv-gym"
    install = (python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt")
    run(*install, wheel, cwd=folder)
    missing = subprocess.run([command, "evaluate"], cwd=folder, capture_output=True, text=True, check=False)
    assert missing.returncode == 2, missing.stderr
    assert missing.stderr == f"auv-gym evaluate needs tyro: pip install 'auv-gym[eval] @ {wheel.as_uri()}'\n"
    run(*install, f"auv-gym[eval] @ {wheel.as_uri()}", cwd=folder)  # as that line says
    blocks = FENCE.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    (folder / "quickstart.py").write_text("\n".join(blocks), encoding="utf-8")
    print(run(python, "quickstart.py", cwd=folder), end="")
    quick = ("--suite", "benchmark-v3", "--policy", "ppo-cruise", "--episodes", "1", "--jobs", "1")
    for words in ((command, "evaluate", *quick), (python, "-m", "baselines", "evaluate", *quick, "--out", "again")):
        print(run(*words, cwd=folder)[-200:])
    assert (folder / "again" / "report.html").exists()
    print(run(command, "--help", cwd=folder))


def main():
    """Build, check and use the package, all in build/package."""
    folder = ROOT / "build" / "package"
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("dist", "again", "use"):
        (folder / name).mkdir(parents=True)
    wheel, sdist = build(ROOT, folder / "dist")
    checked(wheel, sdist, wheel_of(sdist, folder / "again"))
    used(wheel, folder / "use")


if __name__ == "__main__":
    main()
