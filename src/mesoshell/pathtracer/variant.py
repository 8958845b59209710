"""Which compiler and which variant of Mitsuba render: settled before Dr.Jit is imported, or it is too late.

Dr.Jit aborts the process with LLVM 14 to 16, so a libLLVM of the system is not trusted: the one that the extra `mitsuba` brings
is named by its path, unless the user has named another in DRJIT_LIBLLVM_PATH.
"""

import os
import sys
from importlib.metadata import PackageNotFoundError, files

from mesoshell.errors import InputError

#: The wheel that ships a libLLVM.
WHEEL = "karellen-llvm-core"
VARIANT = "llvm_ad_rgb"


def library() -> str | None:
    """Path of the wheel's libLLVM; None if the wheel is not installed."""
    try:
        listed = files(WHEEL) or []
    except PackageNotFoundError:
        return None
    found = sorted(str(f.locate()) for f in listed if f.name.startswith(("libLLVM.so", "libLLVM.dylib", "LLVM-C.dll")))
    return os.path.realpath(found[0]) if found else None


def set_variant() -> None:
    """Make Mitsuba ready: a variant that vectorises. One that the user has set stays if it does."""
    path = library()
    if path and "drjit" not in sys.modules:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", path)
    if "DRJIT_LIBLLVM_PATH" not in os.environ and "drjit" not in sys.modules:
        raise InputError("mitsuba", "no libLLVM that is known to work; install mesoshell[mitsuba]")
    try:
        import mitsuba as mi
    except ImportError as error:
        raise InputError("mitsuba", "is not installed; install mesoshell[mitsuba]") from error
    current = mi.variant()
    if current is None:
        if VARIANT not in mi.variants():
            raise InputError("mitsuba", f"this build has no variant {VARIANT}")
        mi.set_variant(VARIANT)
    elif not current.startswith(("llvm", "cuda")) or not current.endswith("rgb"):
        raise InputError(
            "mitsuba", f"variant {current} is set; shells need {VARIANT} or another llvm or cuda one in rgb"
        )
