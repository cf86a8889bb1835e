"""The one way into numba: where compiled code is kept, and the two decorators of every kernel.

Import this module before numba. Numba's disk cache does not see a change in another file (edit a helper and the old
code runs on), so the cache directory is named by a hash of all kernel sources, of numba, llvmlite and numpy, and of
the CPU: an edit is a new directory, and several versions live side by side.

Kernels release the GIL, divide as numpy does, raise nothing, and are never compiled with ``fastmath`` or contraction:
the geometry's exact predicates would lose hits.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from tracer.native.key import kernel_folder, mark_use


def _activate_cache() -> Path:
    """Point numba's disk cache at the directory of this source, and return it."""
    directory = kernel_folder()
    mark_use(directory)
    os.environ["NUMBA_CACHE_DIR"] = str(directory)
    loaded = sys.modules.get("numba")
    if loaded is not None:  # somebody was first: numba read the environment already
        loaded.core.config.CACHE_DIR = str(directory)
    return directory


KERNEL_CACHE: Final = _activate_cache()

import numba  # noqa: E402 - the cache directory must be set first
from numba import types as numba_types  # noqa: E402

_Function = TypeVar("_Function", bound=Callable[..., Any])
_OPTIONS: Final[dict[str, Any]] = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    "fastmath": False,
    "no_cfunc_wrapper": True,  # nothing calls a kernel by a C pointer: less to compile
}

# Constructor of numba's integers, typed Any because numpy's integers are no `int` to a type checker. `int64(-1)` also
# keeps numba from compiling a copy of a function for the literal -1.
int64: Any = np.int64


def kernel(function: _Function) -> _Function:
    """Compile an entry point, or a function too large to copy into its callers; kept on disk.

    Said explicitly, because numba lets a callee inherit its caller's ``forceinline`` where it has none of its own.
    """
    compiled: _Function = numba.njit(forceinline=False, **_OPTIONS)(function)
    return compiled


def inline(function: _Function) -> _Function:
    """Compile a function that LLVM always copies into its caller; kept on disk for callers in Python."""
    compiled: _Function = numba.njit(forceinline=True, **_OPTIONS)(function)
    return compiled


_config: Any = numba.core.config
PLAIN_PYTHON: Final[bool] = bool(_config.DISABLE_JIT)  # NUMBA_DISABLE_JIT=1: nothing is compiled

if PLAIN_PYTHON:

    def pointer(array: Any) -> Any:
        """Flat view of a C-contiguous array: what stands for a pointer when nothing is compiled."""
        return array.reshape(-1)

else:

    @numba.extending.intrinsic
    def pointer(_context: Any, array: Any) -> Any:
        """Address of a C-contiguous array's first element, indexed like a flat array: ``pointer(a)[3 * row + column]``.

        Arrays are reference-counted, and numba does not remove the counting from inlined callees: it left 9 atomic
        increments inside a loop of 5 lines where pointers leave none. An index is neither wrapped nor checked, so
        it must not be negative. The caller keeps the array alive.
        """
        if array.layout != "C":
            raise numba.errors.TypingError("pointer() needs a C-contiguous array")

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return context.make_array(signature.args[0])(context, builder, arguments[0]).data

        address: Any = numba_types.CPointer(array.dtype)  # type: ignore[no-untyped-call]
        return address(array), generate
