"""Choose the compiler and the variant of Mitsuba, before Dr.Jit is imported and it is too late.

Dr.Jit aborts the process with LLVM 14 to 16, so the system's libLLVM is not trusted: the path of the one that the extra
`mitsuba` installs is set, unless the user has set another in DRJIT_LIBLLVM_PATH; that one is tried in a separate process.
"""

import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, files

from mesoshell.errors import InputError

#: The wheel that ships a libLLVM.
WHEEL = "karellen-llvm-core"
VARIANT = "llvm_ad_rgb"
#: With 14 to 16 Dr.Jit aborts.
MIN_LLVM = 17


def library() -> str | None:
    """Path of the wheel's libLLVM; None if the wheel is not installed."""
    try:
        listed = files(WHEEL) or []
    except PackageNotFoundError:
        return None
    libraries = sorted(
        str(f.locate()) for f in listed if f.name.startswith(("libLLVM.so", "libLLVM.dylib", "LLVM-C.dll"))
    )
    return os.path.realpath(libraries[0]) if libraries else None


def set_variant() -> None:
    """Set a vectorising variant of Mitsuba, or keep the user's if it vectorises. Raises InputError."""
    path, own = library(), os.environ.get("DRJIT_LIBLLVM_PATH")
    if "drjit" not in sys.modules:
        if own and os.path.realpath(own) != path:
            _try(own)
        elif path:
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", path)
        else:
            raise InputError("mitsuba", "no libLLVM that is known to work: pip install mesoshell[mitsuba]")
    else:
        _check_loaded(path)
    try:
        import mitsuba as mi
    except ImportError as error:
        raise InputError("mitsuba", "is not installed: pip install mesoshell[mitsuba]") from error
    current = mi.variant()
    if current is None:
        if VARIANT not in mi.variants():
            raise InputError("mitsuba", f"this build has no variant {VARIANT}")
        mi.set_variant(VARIANT)
    elif not current.startswith(("llvm", "cuda")) or not current.endswith("rgb"):
        raise InputError(
            "mitsuba", f"variant {current} is set; shells need {VARIANT} or another llvm or cuda one in rgb"
        )


def _check_loaded(path: str | None) -> None:
    """Raise InputError if Dr.Jit was imported before and loaded a libLLVM with which it aborts."""
    import drjit

    major = drjit.detail.llvm_version()[0]
    if major < MIN_LLVM:
        text = f"Mitsuba was imported first and found LLVM {major}, with which it aborts: import mesoshell.pathtracer before it"
        raise InputError("mitsuba", text + (f", or set DRJIT_LIBLLVM_PATH={path}" if path else ""))


def _try(path: str) -> None:
    """Raise InputError unless Dr.Jit compiles with this libLLVM, in a process that may abort."""
    code = "import drjit as dr, drjit.llvm as a; assert dr.sum(dr.clip(dr.arange(a.Float, 40) - 3, 0, 9))[0] == 288"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    if done.returncode:
        reason = (
            "Dr.Jit aborts" if done.returncode < 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        )
        raise InputError("DRJIT_LIBLLVM_PATH", f"{path} does not work (unset it to use mesoshell[mitsuba]'s): {reason}")
