"""What the CPU that numba compiles for can do, asked of the compiler itself.

Invariant: the answer is the one that decides the machine code. A CPU's name (``znver3``, ``x86-64-v3``) and its list
of features are looked up nowhere; a few lines are compiled for the configured target, and the instructions in the
assembly tell. So a target set by ``NUMBA_CPU_NAME`` is treated as itself, and an unknown CPU as what LLVM knows of it.
"""

import functools
from typing import Any

from llvmlite import binding, ir


def _probe_module(triple: str, layout: str) -> Any:
    """Eight 32-bit additions, and a lane-crossing permutation that AVX2 does in one instruction."""
    module = ir.Module("probe")
    module.triple = triple
    module.data_layout = layout
    vector = ir.VectorType(ir.IntType(32), 16)
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [ir.PointerType()]), "probe")
    builder = ir.IRBuilder(function.append_basic_block())
    value = builder.load(function.args[0], typ=vector, align=64)
    builder.store(builder.add(value, value), function.args[0], align=64)
    builder.ret_void()
    return module


@functools.lru_cache(maxsize=8)
def _probe(cpu: str, features: str) -> frozenset[str]:
    target = binding.Target.from_default_triple()
    machine = target.create_target_machine(cpu=cpu, features=features, opt=2)
    module = binding.parse_assembly(str(_probe_module(target.triple, str(machine.target_data))))
    assembly = machine.emit_assembly(module)
    found = set()
    if target.name.startswith("x86") and ("%ymm" in assembly or "%zmm" in assembly):
        found.add("avx2")  # 256-bit integer addition is AVX2's
    if "%zmm" in assembly:
        found.add("zmm")
    return frozenset(found)


def features_of(context: Any) -> frozenset[str]:
    """Tell what a lowering may use.

    Parameters
    ----------
    context
        Numba's target context.

    Returns
    -------
    frozenset of str
        ``avx2``: 256-bit integer instructions with variable permutation; ``zmm``: 512-bit registers are in use.
    """
    _triple, cpu, features = context.codegen().magic_tuple()
    return _probe(cpu, features)


def host_features() -> frozenset[str]:
    """Tell the same for kernels compiled in this process.

    Returns
    -------
    frozenset of str
        As :func:`features_of`.
    """
    from numba.core.registry import cpu_target

    return features_of(cpu_target.target_context)


def register_bytes() -> int:
    """Bytes of the widest vector register in use.

    Returns
    -------
    int
        64 (AVX-512), 32 (AVX2), or 16 (SSE2, NEON).
    """
    found = host_features()
    return 64 if "zmm" in found else 32 if "avx2" in found else 16
