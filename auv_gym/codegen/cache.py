"""The folder where compiled code is kept between processes, and the check that other users cannot write to it."""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO

CACHE = "AUV_GYM_CACHE"
"""Environment variable with the folder of compiled code; by default a folder in the user's cache."""
BUILD = "build-"
"""Prefix of the names of temporary folders in which libraries are built."""
DAY = 86400.0  # [s]
UNUSED = 90 * DAY
"""Time since its last use [s] after which a file is removed."""
LEFTOVER = 3600.0
"""Age [s] after which a folder with the prefix `BUILD` is removed; its process was killed."""
_KEPT = re.compile(r"[0-9a-f]{32}\.(so|json)")  # file names of libraries and of what is kept of traces


def cache_folders() -> Iterator[Path]:
    """Yield the folders where compiled code may be kept: the cache, then a temporary folder of this process.

    An environment variable that is empty or a relative path counts as not set, as in the XDG specification. A folder
    that cannot be determined or made is left out.
    """
    chosen, shared = (Path(os.environ.get(name, "")) for name in (CACHE, "XDG_CACHE_HOME"))
    if chosen.is_absolute():
        yield chosen
    elif shared.is_absolute():
        yield shared / "auv_gym"
    else:
        with suppress(RuntimeError):  # the user has no home folder
            if (home := Path.home()).is_absolute():
                yield home / ".cache" / "auv_gym"
    with suppress(OSError):
        yield Path(_temporary_folder().name)


@cache
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Make a folder that other users cannot write to; it is removed at the end of the process."""
    return tempfile.TemporaryDirectory(prefix="auv_gym-", ignore_cleanup_errors=True)  # Windows keeps loaded files


def own_folder(folder: Path) -> Path:
    """Return a folder after a check that only this user and root can write to it; make it if it does not exist.

    Raises:
        OSError: the folder cannot be made, is a link, belongs to another user, or other users may write to it.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if sys.platform != "win32":  # on Windows a folder cannot be opened and has no mode
        os.close(_opened(str(folder), os.O_RDONLY | os.O_DIRECTORY))
    return folder


def open_own(file: Path) -> BinaryIO:
    """Open a file for reading after a check that only this user and root can write to it and to its folder.

    Raises:
        OSError: the folder or the file does not pass the check, see `own_folder`.
    """
    own_folder(file.parent)
    return open(file, "rb", opener=_opened)


def _opened(path: str, flags: int) -> int:
    """Return the descriptor of a file or folder; raise OSError if it is a link or other users can write to it."""
    if sys.platform == "win32":
        return os.open(path, flags)
    handle = os.open(path, flags | os.O_NOFOLLOW)
    state, reason = os.fstat(handle), ""
    if state.st_uid not in (0, os.geteuid()):
        reason = "it belongs to another user"
    elif state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        reason = "other users may write to it"
    if reason:
        os.close(handle)
        raise PermissionError(errno.EPERM, reason, path)
    return handle


def mark_used(file: Path) -> None:
    """Set the modification time of a file to now, at most once a day."""
    with suppress(OSError):  # the file and its folder belong to root
        if time.time() - file.stat().st_mtime > DAY:
            os.utime(file)


def remove_unused(folder: Path) -> None:
    """Remove files that were not used for `UNUSED`, and the folders of builds that were killed."""
    for entry in folder.iterdir():
        with suppress(OSError):  # another process has removed it
            age = time.time() - entry.lstat().st_mtime
            if entry.name.startswith(BUILD) and age > LEFTOVER:
                shutil.rmtree(entry)
            elif _KEPT.fullmatch(entry.name) and age > UNUSED:
                entry.unlink()
