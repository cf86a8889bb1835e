"""numba as a front end: from Python to LLVM's language, and no further.

As it is otherwise, numba optimises every kernel together with all that it calls, level by level, makes machine code and
a wrapper for Python of each, and keeps all that. `for_linking` leaves that out, and what describes, times and announces
the steps, which is a fifth of its time. What it writes is the same to the byte (`tests/tracer/native`).
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import_module("tracer.jit")  # before numba: it says where numba keeps its own cache


@contextmanager
def for_linking() -> Iterator[None]:
    """Have numba write LLVM's language and no more: nothing that it compiles meanwhile can be called.

    What stands for a kernel's Python function must be one of C, and another for each kernel: a list's own `append`.
    """
    caching = import_module("numba.core.caching")
    codegen = import_module("numba.core.codegen")
    context = import_module("numba.core.cpu").CPUContext
    passes = import_module("numba.core.compiler_machinery").PassManager

    def finalize(_context: Any, library: Any, _description: Any, _environment: Any) -> Any:
        library._ensure_finalized()  # noqa: SLF001
        return [].append

    def nothing(*_arguments: Any, **_options: Any) -> None:
        pass

    def run_pass(manager: Any, _index: int, step: Any, state: Any) -> None:
        step.analysis = manager._analysis  # noqa: SLF001
        step.run_initialization(state)
        step.run_pass(state)
        step.run_finalizer(state)

    changes = [
        (codegen.CPUCodeLibrary, "_optimize_functions", nothing),
        (codegen.CPUCodeLibrary, "_optimize_final_module", nothing),
        (codegen.JITCodeLibrary, "_finalize_specific", nothing),
        (context, "create_cpython_wrapper", nothing),
        (context, "get_executable", finalize),
        (import_module("numba.core.event"), "broadcast", nothing),  # millions, that nobody listens to
        (caching.FunctionCache, "load_overload", nothing),
        (caching.FunctionCache, "save_overload", nothing),
        (passes, "_runPass", run_pass),  # without lists of live variables after each step: the last one makes them
    ]
    before = [getattr(owner, name) for owner, name, _ in changes]
    collects = gc.isenabled()
    gc.disable()  # nothing that is made is let go before the end
    for owner, name, change in changes:
        setattr(owner, name, change)
    try:
        yield
    finally:
        for (owner, name, _), old in zip(changes, before, strict=True):
            setattr(owner, name, old)
        if collects:
            gc.enable()
