"""What a process knows of compiled code, for tests of `auv_gym.codegen.native`."""

from auv_gym.codegen import native


def forget() -> None:
    """Forget compilers, folders and libraries, as a new process."""
    for function in (native.library, native.compiler):
        function.cache_clear()
    for found in (native._hung, native._refused, native._logged):
        found.clear()
