"""The folder where compiled code is kept between processes, and the check that no other user can write to it."""

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
"""Environment variable that names another folder for compiled code than that of the user's caches."""
BUILD = "build-"
"""What the name of a folder begins with in which something is being built."""
DAY = 86400.0  # [s]
UNUSED = 90 * DAY
"""Age [s] since its last use at which a library is removed."""
LEFTOVER = 3600.0
"""Age [s] at which a folder of `BUILD` is that of a process that was killed."""
_LIBRARY = re.compile(r"[0-9a-f]{32}\.so")  # names of libraries


def cache_folders() -> Iterator[Path]:
    """Yield the folders where what is made once may be kept: the cache, then one that ends with the process.

    As the XDG specification says of its variables, one that is empty or a relative path counts as not set. Where no
    temporary folder can be made either, there is none.
    """
    own, shared = (Path(os.environ.get(name, "")) for name in (CACHE, "XDG_CACHE_HOME"))
    if own.is_absolute():
        yield own
    elif shared.is_absolute():
        yield shared / "auv_gym"
    else:
        with suppress(RuntimeError):  # there is no home
            if (home := Path.home()).is_absolute():
                yield home / ".cache" / "auv_gym"
    with suppress(OSError):
        yield _temporary()


@cache
def _temporary() -> Path:
    """Return a new folder that no other user can write to; it is removed at the end of the process."""
    folder = tempfile.TemporaryDirectory(prefix="auv_gym-")
    _open_folders.append(folder)
    return Path(folder.name)


_open_folders: list[tempfile.TemporaryDirectory[str]] = []


def own_folder(folder: Path) -> Path:
    """Return a folder, made if need be, once it is known that only this user and root can write to it.

    Raises:
        OSError: it cannot be made, is a link, belongs to another user, or others may write to it.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    if sys.platform != "win32":  # where a folder cannot be opened, and has no mode
        os.close(_opened(str(folder), os.O_RDONLY | os.O_DIRECTORY))
    return folder


def open_own(file: Path) -> BinaryIO:
    """Return a file open to be read, once it is known that only this user and root can write to it and to its folder.

    Raises:
        OSError: see `own_folder`, for the folder and for the file.
    """
    own_folder(file.parent)
    return open(file, "rb", opener=_opened)


def _opened(path: str, flags: int) -> int:
    """Return the descriptor of a file or folder that is no link and that only this user or root can write to."""
    if sys.platform == "win32":
        return os.open(path, flags)
    handle = os.open(path, flags | os.O_NOFOLLOW)
    state, reason = os.fstat(handle), ""
    if state.st_uid not in (0, os.geteuid()):
        reason = "it belongs to another user"
    elif state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        reason = "others may write to it"
    if reason:
        os.close(handle)
        raise PermissionError(errno.EPERM, reason, path)
    return handle


def used(file: Path) -> None:
    """Note that a file is in use, once a day."""
    with suppress(OSError):  # of root's in a folder of root's
        if time.time() - file.stat().st_mtime > DAY:
            os.utime(file)


def tidy(folder: Path) -> None:
    """Remove libraries that have not been used for `UNUSED`, and what killed builds have left."""
    for entry in folder.iterdir():
        with suppress(OSError):  # another process was faster
            age = time.time() - entry.lstat().st_mtime
            if _LIBRARY.fullmatch(entry.name) and age > UNUSED:
                entry.unlink()
            elif entry.name.startswith(BUILD) and age > LEFTOVER:
                shutil.rmtree(entry)
