"""Compiled code: the cache and who may write there, compilers that fail, and what is said where Python takes over."""

import ctypes
import errno
import logging
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from native_cache import forget

from auv_gym.codegen import cache as kept
from auv_gym.codegen import native
from auv_gym.codegen.kernel import Kernel

needs_compiler = pytest.mark.skipif(
    native.compiler() is None or not native.wanted(), reason="compiled code is switched off, or there is no compiler"
)
SOURCE = "double auv_test(void) { return 3; }\n"
OTHERS = 65533  # a user who is not there


def libraries(folder):
    """Return the libraries in a folder but for that of the trial, by time."""
    return sorted((file for file in folder.glob("*.so") if b"auv_test" in file.read_bytes()), key=os.path.getmtime)


def result(source=SOURCE):
    """Return what the function of a source computes."""
    function = native.library(source)["auv_test"]
    function.restype = ctypes.c_double
    return function()


def program(folder, name, text):
    """Return a new program of the shell."""
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)
    return str(file)


def given_to_others(path, monkeypatch):
    """Make an open file or folder look as that of another user: a test need not run as root."""
    real, inode = os.fstat, path.stat().st_ino

    def fstat(handle):
        state = real(handle)
        return os.stat_result((*state[:4], OTHERS, *state[5:])) if state.st_ino == inode else state

    monkeypatch.setattr(os, "fstat", fstat)


def said(caplog):
    """Return the warnings, which go to stderr unless logging is configured."""
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@needs_compiler
def test_a_library_is_built_once(cache, monkeypatch):
    assert result() == 3
    (file,) = libraries(cache)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    forget()
    monkeypatch.setattr(native, "_compile", lambda *_: pytest.fail("it is there already"))
    assert result() == 3
    assert libraries(cache) == [file]
    assert not list(cache.glob(f"{kept.BUILD}*"))


@needs_compiler
def test_one_line_says_that_nothing_is_kept(cache, caplog):
    cache.write_text("a file where the folder should be")
    assert result() == 3
    assert native.library(SOURCE + "\n") is not None
    (line,) = said(caplog)
    assert f"cannot be kept in {cache}: " in line
    assert "each process compiles again" in line


@needs_compiler
def test_the_line_is_seen_where_nothing_is_configured(cache):
    cache.write_text("a file where the folder should be")
    code = f"from auv_gym.codegen import native; assert native.library({SOURCE!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.count("\n") == 1
    assert "compiled code cannot be kept" in done.stderr


def test_without_a_compiler_one_line_says_so(cache, caplog, monkeypatch):
    monkeypatch.setenv("PATH", str(cache))
    monkeypatch.delenv("CC", raising=False)
    assert native.library(SOURCE) is None
    assert native.library(SOURCE + "\n") is None
    (line,) = said(caplog)
    assert "gcc: there is no such program" in line
    assert "equations run as Python, several times slower" in line
    kernel = Kernel.traced(lambda a: {"out": (a[0] * 2.0,)}, {"a": 1})
    np.testing.assert_array_equal(kernel(a=np.array([[1.5, 2.5]]))["out"], [[3.0, 5.0]])


BROKEN = '[ "$1" = --version ] && echo 1.0 && exit 0\necho "no disk" >&2\nexit 1'


def test_a_broken_compiler_alone_is_as_good_as_none(cache, caplog, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", program(tmp_path, "broken-cc", BROKEN))
    monkeypatch.setenv("PATH", str(cache))
    assert native.library(SOURCE) is None
    (line,) = said(caplog)
    assert "no disk" in line


@needs_compiler
def test_a_broken_compiler_is_passed_over(cache, caplog, monkeypatch, tmp_path):
    """One that cannot even be started, and one that fails, before the one that works."""
    monkeypatch.setenv("CC", "'unbalanced")
    monkeypatch.setattr(native, "COMPILERS", (program(tmp_path, "broken-cc", BROKEN), *native.COMPILERS))
    assert result() == 3
    assert native.compiler()[0].endswith(native.COMPILERS[1:])
    assert not said(caplog)


@needs_compiler
def test_a_command_of_several_words_compiles(cache, monkeypatch, tmp_path):
    """CC="ccache gcc", and a name with a blank in it."""
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
def test_a_hanging_compiler_is_given_up_once_with_its_children(cache, caplog, monkeypatch, tmp_path):
    """It passes the trial, and then no source is waited for but the first."""
    real, log = native.compiler()[0], tmp_path / "children"
    forget()
    text = f"""[ "$1" = --version ] && exec {real} --version
cat > "$TMPDIR"/in
if grep -q auv_test "$TMPDIR"/in; then sleep 1000 & echo $! >> {log}; wait; fi
exec {real} "$@" < "$TMPDIR"/in"""
    monkeypatch.setenv("CC", program(tmp_path, "hanging-cc", text))
    monkeypatch.setattr(native, "_PATIENCE", 1.0)
    assert [native.library(SOURCE + "\n" * i) for i in range(5)] == [None] * 5
    (line,) = said(caplog)
    assert "it is not done after 1 s, so equations run as Python" in line
    (child,) = map(int, log.read_text().split())
    with suppress(ProcessLookupError):
        os.kill(child, 0)
        assert Path(f"/proc/{child}/stat").read_text().split()[2] == "Z", "dead, but not yet waited for"


@needs_compiler
def test_a_compiler_that_hangs_at_once_is_passed_over(cache, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", program(tmp_path, "hanging-cc", "sleep 1000"))
    monkeypatch.setattr(native, "_PATIENCE", 1.0)
    assert result() == 3


@needs_compiler
def test_damaged_libraries_are_built_again(cache):
    """No library, an empty file, and a library of something else, whose symbol is missing."""
    assert result() == 3
    (file,) = libraries(cache)
    other = file.read_bytes().replace(b"auv_gym_", b"auv_no__")
    for content in (b"not a library", b"", other):
        file.unlink()  # the loaded one stays mapped
        file.write_bytes(content)
        file.chmod(0o755)
        forget()
        assert result() == 3
        assert libraries(cache) == [file]
        assert file.read_bytes() != content


@needs_compiler
@pytest.mark.parametrize("reason", ["failed to map segment from shared object", "Too many open files"])
def test_a_good_library_is_kept_where_it_cannot_be_loaded(cache, caplog, monkeypatch, reason):
    """As in a home that is mounted noexec: the library of another machine on the same disk."""
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
    (line,) = said(caplog)
    assert reason in line


@needs_compiler
def test_code_of_others_is_not_loaded(cache, monkeypatch):
    """A library in the folder of another user, in one where others may write, and behind a link."""
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
    assert result() == 4, "else this test would show nothing"
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
        given_to_others(file, patch)
        assert result() == 3
    place()
    with monkeypatch.context() as patch:
        given_to_others(cache, patch)
        assert result() == 3
        assert file.read_bytes() == planted


@pytest.mark.parametrize("cache_variable", [None, "", "relative/cache"])
@pytest.mark.parametrize("xdg", [None, "", "relative"])
def test_empty_and_relative_folders_count_as_not_set(cache_variable, xdg, monkeypatch, tmp_path):
    for name, value in (("AUV_GYM_CACHE", cache_variable), ("XDG_CACHE_HOME", xdg), ("HOME", str(tmp_path))):
        monkeypatch.delenv(name, raising=False) if value is None else monkeypatch.setenv(name, value)
    first, temporary = kept.cache_folders()
    assert first == tmp_path / ".cache" / "auv_gym"
    assert temporary.is_absolute()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert next(kept.cache_folders()) == tmp_path / "auv_gym"
    monkeypatch.setenv("AUV_GYM_CACHE", str(tmp_path))
    assert next(kept.cache_folders()) == tmp_path


@needs_compiler
def test_without_any_folder_python_takes_over(cache, caplog, monkeypatch):
    """A container whose disk is read-only."""
    cache.write_text("a file where the folder should be")

    def full():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr(kept, "_temporary", full)
    assert native.library(SOURCE) is None
    (line,) = said(caplog)
    assert "cannot be kept in" in line
    assert "equations run as Python" in line
    monkeypatch.delenv(native.CACHE)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", "nowhere")
    forget()
    assert native.library(SOURCE) is None
    assert "there is no folder for compiled code" in said(caplog)[-1]


@needs_compiler
def test_a_compiler_needs_no_temporary_folder_of_its_own(cache, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "missing"))
    assert result() == 3


@needs_compiler
def test_a_full_disk_costs_the_cache_alone(cache, caplog, monkeypatch):
    """What fits is the trial; the compiler itself says that there is no room."""
    real = native._compile

    def compile_(command, source, made, flags):
        if "auv_test" in source and made.is_relative_to(cache):
            raise subprocess.CalledProcessError(1, command, stderr=b"ld: No space left on device\n")
        real(command, source, made, flags)

    monkeypatch.setattr(native, "_compile", compile_)
    assert result() == 3
    (line,) = said(caplog)
    assert "No space left on device" in line


@needs_compiler
def test_the_cache_has_a_bound(cache):
    """A build removes what was not used for 90 days and what killed builds have left, and nothing else."""
    assert result() == 3
    (old,) = libraries(cache)
    (trial,) = set(cache.glob("*.so")) - {old}
    left, running = cache / f"{kept.BUILD}left", cache / f"{kept.BUILD}running"
    for folder in (left, running):
        folder.mkdir()
        (folder / "half").touch()
    foreign = cache / "notes.txt"
    foreign.touch()
    for path in (old, trial, left, foreign):
        os.utime(path, (0, time.time() - 91 * kept.DAY))
    forget()
    assert native.compiler() is not None
    assert time.time() - trial.stat().st_mtime < kept.DAY, "it was used"
    assert native.library(SOURCE + "\n") is not None
    assert not old.exists()
    assert not left.exists()
    assert trial.exists()
    assert running.exists()
    assert foreign.exists()


@needs_compiler
def test_a_worker_process_does_not_repeat_the_line(cache, caplog, monkeypatch):
    import multiprocessing

    cache.write_text("a file where the folder should be")
    monkeypatch.setattr(multiprocessing, "parent_process", object)
    assert result() == 3
    assert not said(caplog)


@needs_compiler
def test_word_size_and_processor_belong_to_the_name(cache, monkeypatch):
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
    "s390x": "vendor_id       : IBM/S390\nfeatures\t: esan3 {}\nbogomips per cpu: 1\n",
    "power": "processor\t: 0\ncpu\t\t: POWER{}\nclock\t\t: 1MHz\n",
    "riscv": "hart\t\t: 0\nisa\t\t: {}\n",
}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")
@pytest.mark.parametrize("kind", CPUINFO)
def test_processors_of_other_instructions_have_other_keys(kind, monkeypatch):
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
def test_processes_that_build_at_once_share_one_library(cache):
    code = f"from auv_gym.codegen import native; assert native.library({SOURCE!r}).auv_test"
    environment = {**os.environ, native.CACHE: str(cache)}
    running = [subprocess.Popen([sys.executable, "-c", code], env=environment) for _ in range(3)]
    assert [process.wait(60) for process in running] == [0, 0, 0]
    assert len(libraries(cache)) == 1


@needs_compiler
def test_an_interrupt_ends_the_compiler(cache, tmp_path):
    """It is in a session of its own, where Ctrl-C does not reach it."""
    compiler = program(tmp_path, "slow-cc", f"echo $$ > {tmp_path}/pid\nexec sleep 1000")
    code = f"from auv_gym.codegen import native; native.library({SOURCE!r})"
    environment = {**os.environ, native.CACHE: str(cache), "CC": compiler}
    running = subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL)
    pid = tmp_path / "pid"
    while not (pid.exists() and pid.read_text().strip()):
        assert running.poll() is None
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    assert running.wait(30) != 0
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


FIRST_USE = """
import gymnasium as gym
env = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario="cruise-storm")
for seed in range(3):
    env.reset(seed=seed)
    env.step(env.action_space.sample())
"""


@needs_compiler
def test_the_first_use_says_in_one_line_that_it_compiles_and_the_next_says_nothing(cache):
    """Three libraries: the planner's, that of the exogenous inputs, and that of the vehicle with its law."""
    environment = {**os.environ, native.CACHE: str(cache)}
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", FIRST_USE], env=environment, capture_output=True, text=True, check=True
        )
        said.append(done.stderr)
        assert len([*cache.glob("*.so")]) == 4  # and that of the trial
    assert said == ["auv_gym: compiling the equations of motion for this machine; this happens once\n", ""]
