"""Compiled code in tests of `auv_gym.codegen`."""

from auv_gym.codegen import kernel, native


def forget() -> None:
    """Forget compilers, folders, libraries and kernels, as a new process."""
    native.compiler.cache_clear()
    for memory in (native._libraries, native._refused, native._logged, kernel._kernels):
        memory.clear()


def compiled(source: str):
    """Return the library of a source, see `native.library`."""
    return native.library(source, lambda: source)
