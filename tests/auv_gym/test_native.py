"""Compiled code: the cache and its permissions, compilers that fail, and the warnings without compiled code."""

import ctypes
import errno
import logging
import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from native_cache import compiled, forget

from auv_gym.codegen import cache as cache_module
from auv_gym.codegen import native
from auv_gym.codegen.kernel import Kernel

needs_compiler = pytest.mark.skipif(
    native.compiler() is None or not native.wanted(), reason="compiled code is switched off, or there is no compiler"
)
SOURCE = "double auv_test(void) { return 3; }\n"
OTHER_USER = 65533  # a user id that does not exist


def libraries(folder):
    """Return the libraries in a folder by time, without that of the trial."""
    return sorted((file for file in folder.glob("*.so") if b"auv_test" in file.read_bytes()), key=os.path.getmtime)


def result(source=SOURCE):
    """Return the result of the function of a source."""
    function = compiled(source)["auv_test"]
    function.restype = ctypes.c_double
    return function()


def program(folder, name, text):
    """Write a shell script and return its path."""
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return str(file)


def change_owner(path, monkeypatch):
    """Let `os.fstat` report another owner of a file or folder, without the rights of root."""
    real, inode = os.fstat, path.stat().st_ino

    def fstat(handle):
        state = real(handle)
        return os.stat_result((*state[:4], OTHER_USER, *state[5:])) if state.st_ino == inode else state

    monkeypatch.setattr(os, "fstat", fstat)


def warnings_of(caplog):
    """Return the logged warnings; they go to stderr if logging is not configured."""
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@needs_compiler
def test_a_library_is_built_once(cache, monkeypatch):
    assert result() == 3
    (file,) = libraries(cache)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    forget()
    monkeypatch.setattr(native, "_compile", lambda *_: pytest.fail("the library exists"))
    assert result() == 3
    assert libraries(cache) == [file]
    assert not list(cache.glob(f"{cache_module.BUILD}*"))


@needs_compiler
def test_a_warning_says_that_code_cannot_be_kept(cache, caplog):
    cache.write_text("a file where the folder should be")
    assert result() == 3
    assert compiled(SOURCE + "\n") is not None
    (line,) = warnings_of(caplog)
    assert f"cannot be kept in {cache}: " in line
    assert "each process compiles again" in line


def test_a_warning_says_that_there_is_no_compiler(cache, caplog, monkeypatch):
    monkeypatch.setenv("PATH", str(cache))
    monkeypatch.delenv("CC", raising=False)
    assert compiled(SOURCE) is None
    assert compiled(SOURCE + "\n") is None
    (line,) = warnings_of(caplog)
    assert "gcc: the program does not exist" in line
    assert "equations run as Python, several times slower" in line
    kernel = Kernel.traced(lambda a: {"out": (a[0] * 2.0,)}, {"a": 1})
    np.testing.assert_array_equal(kernel(a=np.array([[1.5, 2.5]]))["out"], [[3.0, 5.0]])


BROKEN = '[ "$1" = --version ] && echo 1.0 && exit 0\necho "no disk" >&2\nexit 1'


@needs_compiler
def test_a_broken_compiler_is_skipped(cache, caplog, monkeypatch, tmp_path):
    """The first cannot be started, the second fails, the third works."""
    monkeypatch.setenv("CC", "'unbalanced")
    monkeypatch.setattr(native, "COMPILERS", (program(tmp_path, "broken-cc", BROKEN), *native.COMPILERS))
    assert result() == 3
    assert native.compiler()[0].endswith(native.COMPILERS[1:])
    assert not warnings_of(caplog)


@needs_compiler
def test_a_command_of_several_words_compiles(cache, monkeypatch, tmp_path):
    """CC="ccache gcc", with a space in the path."""
    real = native.compiler()[0]
    forget()
    folder = tmp_path / "a folder"
    folder.mkdir()
    wrapper = program(folder, "ccache", f'echo "$@" >> {tmp_path}/log\nexec "$@"')
    monkeypatch.setenv("CC", f"'{wrapper}' {real}")
    assert result() == 3
    assert native.compiler()[0] == f"'{wrapper}' {real}"
    assert (tmp_path / "log").read_text().count("-shared") == 2  # the trial and the source


@needs_compiler
def test_a_compiler_that_hangs_at_once_is_skipped(cache, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", program(tmp_path, "hanging-cc", "sleep 1000"))
    monkeypatch.setattr(native, "_PATIENCE", 1.0)
    assert result() == 3


@needs_compiler
def test_a_slow_compiler_has_time_in_proportion_to_the_source(cache, monkeypatch, tmp_path):
    real = native.compiler()[0]
    forget()
    slow = program(tmp_path, "slow-cc", f'case "$*" in *shared*) sleep 1.2;; esac\nexec {real} "$@"')
    monkeypatch.setenv("CC", slow)
    monkeypatch.setattr(native, "_PATIENCE", 1.0)
    monkeypatch.setattr(native, "_SLOWEST", 20.0)
    assert result() == 3
    assert native.compiler()[0] == slow


@needs_compiler
def test_damaged_libraries_are_built_again(cache):
    assert result() == 3
    (file,) = libraries(cache)
    for content in (b"not a library", b""):
        file.unlink()  # the loaded one stays mapped
        file.write_bytes(content)
        file.chmod(0o755)
        forget()
        assert result() == 3
        assert libraries(cache) == [file]
        assert file.read_bytes() != content


@needs_compiler
def test_a_library_that_cannot_be_loaded_is_kept(cache, caplog, monkeypatch):
    """For example in a home folder that is mounted noexec on one of two machines."""
    reason = "failed to map segment from shared object"
    assert result() == 3
    (file,) = libraries(cache)
    before = file.stat()
    forget()
    real = ctypes.CDLL

    def refusing(name, *rest):
        if Path(name).is_relative_to(cache):
            raise OSError(f"{name}: {reason}")
        return real(name, *rest)

    monkeypatch.setattr(ctypes, "CDLL", refusing)
    assert result() == 3
    after = file.stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    (line,) = warnings_of(caplog)
    assert reason in line


@needs_compiler
def test_code_of_other_users_is_not_loaded(cache, monkeypatch):
    """A library of another user, in the folder of one, writable by others, in a writable folder, behind a link."""
    assert result() == 3
    (file,) = libraries(cache)
    good = file.read_bytes()
    planted = good.replace(np.float64(3).tobytes(), np.float64(4).tobytes())
    assert planted != good
    home = cache.with_name("home")

    def place(folder_mode=0o700, file_mode=0o755):
        for folder in (cache, home):
            shutil.rmtree(folder) if folder.is_dir() and not folder.is_symlink() else folder.unlink(missing_ok=True)
        cache.mkdir(folder_mode)
        cache.chmod(folder_mode)
        file.write_bytes(planted)
        file.chmod(file_mode)
        forget()

    place()
    assert result() == 4, "the planted library is loaded"
    place(folder_mode=0o777)
    assert result() == 3
    place(file_mode=0o775)
    assert result() == 3
    place()
    cache.rename(home)
    cache.symlink_to(home)
    assert result() == 3
    place()
    home.mkdir()
    file.rename(home / file.name)
    file.symlink_to(home / file.name)
    assert result() == 3
    place()
    with monkeypatch.context() as patch:
        change_owner(file, patch)
        assert result() == 3
    place()
    with monkeypatch.context() as patch:
        change_owner(cache, patch)
        assert result() == 3
        assert file.read_bytes() == planted


@pytest.mark.parametrize(("cache_variable", "xdg"), [(None, ""), ("", "relative"), ("relative/cache", None)])
def test_empty_and_relative_folders_count_as_not_set(cache_variable, xdg, monkeypatch, tmp_path):
    for name, value in (("AUV_GYM_CACHE", cache_variable), ("XDG_CACHE_HOME", xdg), ("HOME", str(tmp_path))):
        monkeypatch.delenv(name, raising=False) if value is None else monkeypatch.setenv(name, value)
    first, temporary = cache_module.cache_folders()
    assert first == tmp_path / ".cache" / "auv_gym"
    assert temporary.is_absolute()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert next(cache_module.cache_folders()) == tmp_path / "auv_gym"
    monkeypatch.setenv("AUV_GYM_CACHE", str(tmp_path))
    assert next(cache_module.cache_folders()) == tmp_path


@needs_compiler
def test_without_a_folder_equations_run_as_python(cache, caplog, monkeypatch):
    """For example in a container with a read-only disk."""
    cache.write_text("a file where the folder should be")

    def read_only():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr(cache_module, "_temporary_folder", read_only)
    assert compiled(SOURCE) is None
    (line,) = warnings_of(caplog)
    assert "cannot be kept in" in line
    assert "equations run as Python" in line
    monkeypatch.delenv(native.CACHE)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "nowhere")
    forget()
    assert compiled(SOURCE) is None
    assert "there is no folder for compiled code" in warnings_of(caplog)[-1]


@needs_compiler
def test_unused_libraries_are_removed(cache):
    """A build removes libraries that were not used for 90 days and the folders of killed builds, nothing else."""
    assert result() == 3
    (old,) = libraries(cache)
    (trial,) = set(cache.glob("*.so")) - {old}
    left, running = cache / f"{cache_module.BUILD}left", cache / f"{cache_module.BUILD}running"
    for folder in (left, running):
        folder.mkdir()
        (folder / "half").touch()
    foreign = cache / "notes.txt"
    foreign.touch()
    for path in (old, trial, left, foreign):
        os.utime(path, (0, time.time() - 91 * cache_module.DAY))
    forget()
    assert native.compiler() is not None
    assert time.time() - trial.stat().st_mtime < cache_module.DAY, "it was used"
    assert compiled(SOURCE + "\n") is not None
    assert not old.exists()
    assert not left.exists()
    assert trial.exists()
    assert running.exists()
    assert foreign.exists()


@needs_compiler
def test_compiled_code_on_windows(cache, caplog, monkeypatch):
    """There, files have no owner and no mode, and a library that another process has loaded cannot be replaced."""
    for module in (native, cache_module):
        monkeypatch.setattr(module, "sys", SimpleNamespace(platform="win32", stderr=sys.stderr))
    monkeypatch.setattr(os, "geteuid", lambda: pytest.fail("Windows has no user ids"))
    real = Path.replace

    def replace(made, file):
        shutil.copy(made, file)
        raise PermissionError(errno.EACCES, "Access is denied", str(file))

    for move in (real, replace):
        monkeypatch.setattr(Path, "replace", move)
        shutil.rmtree(cache, ignore_errors=True)
        forget()
        assert result() == 3
        assert len(libraries(cache)) == 1
        assert not list(cache.glob(f"{cache_module.BUILD}*"))
        forget()
        with monkeypatch.context() as patch:
            patch.setattr(native, "_compile", lambda *_: pytest.fail("the library exists"))
            assert result() == 3
    assert not warnings_of(caplog)


@needs_compiler
def test_file_names_depend_on_word_size_and_processor(cache, monkeypatch):
    assert result() == 3
    monkeypatch.setattr(native.struct, "calcsize", lambda _: 4)
    forget()
    assert result() == 3
    monkeypatch.setattr(native, "_processor", lambda: "another one")
    forget()
    assert result() == 3
    assert len(libraries(cache)) == 3


CPUINFO = {
    "x86": "processor\t: 0\nmodel name\t: A\nflags\t\t: fpu {}\ncpu MHz\t\t: 1.5\n",
    "arm64": "processor\t: 0\nBogoMIPS\t: 1\nFeatures\t: fp\nCPU implementer\t: 0x41\nCPU part\t: {}\n",
}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")
@pytest.mark.parametrize("kind", CPUINFO)
def test_keys_of_processors_depend_on_their_instruction_sets(kind, monkeypatch):
    def key(text):
        monkeypatch.setattr(Path, "read_text", lambda *_, **__: text)
        native._processor.cache_clear()
        return native._processor()

    try:
        assert key(CPUINFO[kind].format("a")) != key(CPUINFO[kind].format("b"))
        assert key(CPUINFO[kind]) == key(CPUINFO[kind].replace("1.5", "2.5")) != ""
    finally:
        native._processor.cache_clear()


@needs_compiler
def test_concurrent_builds_leave_one_library(cache):
    code = f"from auv_gym.codegen import native; assert native.library('a', lambda: {SOURCE!r}).auv_test"
    environment = {**os.environ, native.CACHE: str(cache)}
    running = [subprocess.Popen([sys.executable, "-c", code], env=environment) for _ in range(3)]
    assert [process.wait(60) for process in running] == [0, 0, 0]
    assert len(libraries(cache)) == 1


FIRST_USE = """
import gymnasium as gym
env = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario="cruise-storm")
for seed in range(3):
    env.reset(seed=seed)
    env.step(env.action_space.sample())
"""


@needs_compiler
def test_only_the_first_use_prints_that_it_compiles(cache):
    """There are three libraries: of the planner, of the exogenous inputs, and of the vehicle with its control law.

    The second process traces nothing.
    """
    environment = {**os.environ, native.CACHE: str(cache)}
    printed = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", FIRST_USE], env=environment, capture_output=True, text=True, check=True
        )
        printed.append(done.stderr)
        assert len([*cache.glob("*.so")]) == 4  # three and that of the trial
    assert printed == ["auv_gym: compiling equations for this machine, once for each kind of scenario and policy\n", ""]
