"""Lanes: LLVM vectors as values inside Numba kernels.

A :class:`~tracer.simd.types.VectorType` value is 4, 8 or 16 numbers that one instruction adds or compares. Operators
(``+ - * /``, comparisons, ``& | ^ ~``) and the functions named here take vectors and scalars alike, so a shading
function written once serves one ray and sixteen.

Invariants
----------
* Every operation is the IEEE 754 one, lane by lane, in round to nearest; nothing is contracted to a fused
  multiply-add unless :func:`fma` says so. The same source gives the same bits on every CPU (but for `multiply_add`,
  which leaves the choice to the CPU and is for bounds alone).
* Only generic LLVM operations are emitted, except where :mod:`tracer.simd.features` has asked the compiler and a
  generic fallback stands beside; no illegal instruction on any CPU.
* A comparison yields a mask, a vector of booleans. Comparisons with a NaN are false, ``!=`` is true.

The pieces: `types` (the vector types), `arithmetic` (operators, fma, minimum, conversions), `lanes` (masks, select,
permute, compress, reductions), `memory` (addresses, loads and stores, stack memory, gather), `elementary` (exp, log,
pow, sine, cosine), `features` (what the CPU offers).

Source: ``../shared/design/core.md`` ("How").
"""

from tracer.simd.arithmetic import (
    absolute,
    bitcast,
    convert,
    floor,
    fma,
    from_bits,
    full_like,
    lesser_finite,
    maximum,
    minimum,
    multiply_add,
    splat,
    sqrt,
    to_bits,
)
from tracer.simd.elementary import cos, exp, log, power, rsqrt, sin, sin_cos
from tracer.simd.lanes import (
    all_lanes,
    any_lane,
    compress,
    concatenate,
    count_trailing_zeros,
    extract,
    insert,
    iota,
    lower_half,
    mask_from_bits,
    mask_to_bits,
    permute,
    population_count,
    reduce_add,
    reduce_max,
    reduce_min,
    select,
    unlikely,
    upper_half,
)
from tracer.simd.memory import (
    address_of,
    bytes_of,
    element_type,
    gather,
    load,
    load_as_float64,
    prefetch,
    stack_memory,
    store,
)
from tracer.simd.types import (
    VectorType,
    float32x4,
    float32x8,
    float32x16,
    float64x4,
    float64x8,
    int32x4,
    int32x8,
    int32x16,
    int64x4,
    int64x8,
    mask4,
    mask8,
    mask16,
)

__all__ = [
    "VectorType",
    "absolute",
    "address_of",
    "all_lanes",
    "any_lane",
    "bitcast",
    "bytes_of",
    "compress",
    "concatenate",
    "convert",
    "cos",
    "count_trailing_zeros",
    "element_type",
    "exp",
    "extract",
    "float32x4",
    "float32x8",
    "float32x16",
    "float64x4",
    "float64x8",
    "floor",
    "fma",
    "from_bits",
    "full_like",
    "gather",
    "insert",
    "int32x4",
    "int32x8",
    "int32x16",
    "int64x4",
    "int64x8",
    "iota",
    "lesser_finite",
    "load",
    "load_as_float64",
    "log",
    "lower_half",
    "mask4",
    "mask8",
    "mask16",
    "mask_from_bits",
    "mask_to_bits",
    "maximum",
    "minimum",
    "multiply_add",
    "permute",
    "population_count",
    "power",
    "prefetch",
    "reduce_add",
    "reduce_max",
    "reduce_min",
    "rsqrt",
    "select",
    "sin",
    "sin_cos",
    "splat",
    "sqrt",
    "stack_memory",
    "store",
    "to_bits",
    "unlikely",
    "upper_half",
]
