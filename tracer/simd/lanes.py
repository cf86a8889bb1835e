"""Masks, selection, and moving values between lanes.

Invariants: bit ``i`` of a mask's integer is lane ``i``; `compress` moves the chosen lanes to the front in order, and
what lies behind them is unspecified; `permute` reads lane ``index % lanes``. Where AVX2's variable permutation is
there (:mod:`tracer.simd.features`) it is used, with a table for `compress`; else the generic LLVM operations.

Source: LLVM language reference, "llvm.experimental.vector.compress".
"""

from typing import Any, Final

from llvmlite import ir

from tracer.simd.arithmetic import call_intrinsic
from tracer.simd.features import features_of
from tracer.simd.gateway import cgutils, intrinsic, types
from tracer.simd.types import (
    INDEX,
    POINTER,
    VectorType,
    element_of,
    is_float,
    is_number,
    lane_numbers,
    llvm_bits,
    llvm_type,
    shuffle,
    suffix,
)

_I1: Final = ir.IntType(1)
_I8: Final = ir.IntType(8)
_I64: Final = ir.IntType(64)


@intrinsic
def select(_typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """Take ``a`` where the mask is set, else ``b``, lane by lane; a scalar boolean chooses the whole."""
    if a != b or element_of(mask) != types.boolean:
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return a(mask, a, b), generate


@intrinsic
def mask_to_bits(_typing: Any, mask: Any) -> Any:
    """Return the mask as an int64, lane 0 in bit 0."""
    if not isinstance(mask, VectorType) or mask.dtype != types.boolean:
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.lanes)), _I64)

    return types.int64(mask), generate


@intrinsic
def mask_from_bits(_typing: Any, kind: Any, value: Any) -> Any:
    """``mask_from_bits(mask8, 5)``: the mask with lanes 0 and 2 set."""
    del value
    target = kind.instance_type

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[1], ir.IntType(target.lanes)), llvm_type(target))

    return target(kind, types.int64), generate


def _reduce_mask(name: str, predicate: str, number: int) -> Any:
    def typer(_typing: Any, mask: Any) -> Any:
        if element_of(mask) != types.boolean:
            return None

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            if not isinstance(mask, VectorType):
                return args[0]
            bits = ir.IntType(mask.lanes)
            return builder.icmp_unsigned(predicate, builder.bitcast(args[0], bits), ir.Constant(bits, number))

        return types.boolean(mask), generate

    typer.__name__ = name
    return intrinsic(typer)


# Whether a lane, or every lane, is set; a scalar boolean is itself.
any_lane = _reduce_mask("any_lane", "!=", 0)
all_lanes = _reduce_mask("all_lanes", "==", -1)


@intrinsic
def extract(_typing: Any, vector: Any, lane: Any) -> Any:
    """Return the value of one lane; undefined when the lane is out of range."""
    if not isinstance(vector, VectorType) or not isinstance(lane, types.Integer):
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], builder.trunc(args[1], INDEX))

    return vector.dtype(vector, types.int64), generate


@intrinsic
def insert(_typing: Any, vector: Any, lane: Any, value: Any) -> Any:
    """Return the vector with one lane replaced."""
    if not isinstance(vector, VectorType) or not isinstance(lane, types.Integer):
        return None
    del value

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.insert_element(args[0], args[2], builder.trunc(args[1], INDEX))

    return vector(vector, types.int64, vector.dtype), generate


@intrinsic
def iota(_typing: Any, kind: Any) -> Any:
    """``iota(int32x8)``: 0, 1, 2, ... in the lanes."""
    target = kind.instance_type

    def generate(_context: Any, _builder: Any, _sig: Any, _args: Any) -> Any:
        wanted = llvm_type(target)
        return ir.Constant(wanted, [ir.Constant(wanted.element, lane) for lane in range(target.lanes)])

    return target(kind), generate


@intrinsic
def transpose(_typing: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Turn four vectors of four lanes, the rows of a matrix, into its columns."""
    if not isinstance(a, VectorType) or a.lanes != 4 or not a == b == c == d:
        return None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pairs = [
            builder.shuffle_vector(low, high, lane_numbers(lanes))
            for lanes in ([0, 4, 2, 6], [1, 5, 3, 7])
            for low, high in (args[:2], args[2:])
        ]
        columns = [
            builder.shuffle_vector(pairs[odd], pairs[odd + 1], lane_numbers(lanes))
            for lanes in ([0, 1, 4, 5], [2, 3, 6, 7])
            for odd in (0, 2)
        ]
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(a, 4)(a, b, c, d), generate


@intrinsic
def deinterleave(_typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Split twelve consecutive values, x y z x y z ... in three vectors of four lanes, into the x, the y and the z."""
    if not isinstance(a, VectorType) or a.lanes != 4 or not a == b == c:
        return None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        columns = []
        for k in range(3):
            taken = [(number // 4, number % 4) for number in range(k, 12, 3)]
            first = [lane + 4 * which for which, lane in taken if which < 2]
            joined = builder.shuffle_vector(args[0], args[1], lane_numbers(first + [0] * (4 - len(first))))
            last = [4 + lane for which, lane in taken if which == 2]
            order = list(range(len(first))) + last
            columns.append(builder.shuffle_vector(joined, args[2], lane_numbers(order)))
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(a, 3)(a, b, c), generate


def _half(name: str, which: int) -> Any:
    def typer(_typing: Any, vector: Any) -> Any:
        half = vector.lanes // 2

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            return shuffle(builder, args[0], list(range(which * half, (which + 1) * half)))

        return vector.with_lanes(half)(vector), generate

    typer.__name__ = name
    return intrinsic(typer)


lower_half = _half("lower_half", 0)
upper_half = _half("upper_half", 1)


@intrinsic
def concatenate(_typing: Any, a: Any, b: Any) -> Any:
    """One vector of twice the lanes: those of ``a``, then those of ``b``."""
    if a != b or not isinstance(a, VectorType):
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.shuffle_vector(args[0], args[1], lane_numbers(list(range(2 * a.lanes))))

    return a.with_lanes(2 * a.lanes)(a, b), generate


def _is_register_of_words(vector: VectorType) -> bool:
    """Eight lanes of 32 bits: what AVX2 permutes in one instruction."""
    return vector.lanes == 8 and llvm_bits(vector.dtype) == 32


def _emit_permute(context: Any, builder: Any, vector: VectorType, value: Any, index: Any) -> Any:
    if _is_register_of_words(vector) and "avx2" in features_of(context):
        name = "llvm.x86.avx2.permps" if is_float(vector) else "llvm.x86.avx2.permd"
        return call_intrinsic(builder, name, value.type, [value, index])
    result = ir.Constant(value.type, ir.Undefined)
    for lane in range(vector.lanes):
        number = builder.extract_element(index, ir.Constant(INDEX, lane))
        number = builder.and_(number, ir.Constant(number.type, vector.lanes - 1))
        result = builder.insert_element(result, builder.extract_element(value, number), ir.Constant(INDEX, lane))
    return result


@intrinsic
def permute(_typing: Any, vector: Any, index: Any) -> Any:
    """Lane ``i`` of the result is lane ``index[i] % lanes`` of the vector; ``index`` is as many int32."""
    if not isinstance(vector, VectorType) or index != vector.with_dtype(types.int32):
        return None

    def generate(context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return _emit_permute(context, builder, vector, *args)

    return vector(vector, index), generate


def _compress_orders() -> bytes:
    """Row ``mask`` of the table: the lanes set in an 8-bit mask, in order, then zeros."""
    rows = bytearray()
    for mask in range(256):
        chosen = [lane for lane in range(8) if mask >> lane & 1]
        rows += bytes(chosen + [0] * (8 - len(chosen)))
    return bytes(rows)


def _emit_compress_by_table(builder: Any, vector: VectorType, value: Any, mask: Any) -> Any:
    name = "smalti.simd.compress_orders"
    table = builder.module.globals.get(name)
    if table is None:
        table = cgutils.global_constant(builder, name, cgutils.make_bytearray(_compress_orders()))
    row = builder.zext(builder.bitcast(mask, _I8), _I64)
    address = builder.gep(table, [ir.Constant(_I64, 0), builder.mul(row, ir.Constant(_I64, 8))])
    order = builder.load(builder.bitcast(address, POINTER), typ=ir.VectorType(_I8, 8), align=8)
    index = builder.zext(order, ir.VectorType(INDEX, 8))
    permutation = "llvm.x86.avx2.permps" if is_float(vector) else "llvm.x86.avx2.permd"
    return call_intrinsic(builder, permutation, value.type, [value, index])


@intrinsic
def compress(_typing: Any, vector: Any, mask: Any) -> Any:
    """Move the lanes whose mask is set to the front, in order; the lanes behind them are unspecified."""
    if not isinstance(vector, VectorType) or mask != vector.mask:
        return None

    def generate(context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        found = features_of(context)
        if _is_register_of_words(vector) and "avx2" in found and "zmm" not in found:
            return _emit_compress_by_table(builder, vector, *args)
        name = f"llvm.experimental.vector.compress.{suffix(vector)}"
        return call_intrinsic(builder, name, args[0].type, [*args, ir.Constant(args[0].type, ir.Undefined)])

    return vector(vector, mask), generate


def _reduction(name: str, combine: Any) -> Any:
    def typer(_typing: Any, vector: Any) -> Any:
        if not isinstance(vector, VectorType) or not is_number(vector):
            return None

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            value, lanes = args[0], vector.lanes
            while lanes > 1:  # upper half onto lower half, always in this order: the same sum everywhere
                lanes //= 2
                low = shuffle(builder, value, list(range(lanes)))
                high = shuffle(builder, value, list(range(lanes, 2 * lanes)))
                value = combine(builder, vector, low, high)
            return builder.extract_element(value, ir.Constant(INDEX, 0))

        return vector.dtype(vector), generate

    typer.__name__ = name
    return intrinsic(typer)


def _lesser(builder: Any, vector: VectorType, low: Any, high: Any) -> Any:
    compare = builder.fcmp_ordered if is_float(vector) else builder.icmp_signed
    return builder.select(compare("<", low, high), low, high)


def _greater(builder: Any, vector: VectorType, low: Any, high: Any) -> Any:
    compare = builder.fcmp_ordered if is_float(vector) else builder.icmp_signed
    return builder.select(compare(">", low, high), low, high)


def _sum(builder: Any, vector: VectorType, low: Any, high: Any) -> Any:
    return builder.fadd(low, high) if is_float(vector) else builder.add(low, high)


# The smallest, the largest and the sum over all lanes, by halving; a NaN in a lane makes min and max unspecified.
reduce_min = _reduction("reduce_min", _lesser)
reduce_max = _reduction("reduce_max", _greater)
reduce_add = _reduction("reduce_add", _sum)


def _count_bits(name: str, function: str, extra: list[Any]) -> Any:
    def typer(_typing: Any, value: Any) -> Any:
        if not isinstance(value, types.Integer):
            return None

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            return call_intrinsic(builder, f"llvm.{function}.i64", _I64, [args[0], *extra])

        return types.int64(types.int64), generate

    typer.__name__ = name
    return intrinsic(typer)


# Of an int64: the number of the lowest set bit (undefined for 0), and how many bits are set.
count_trailing_zeros = _count_bits("count_trailing_zeros", "cttz", [ir.Constant(_I1, 1)])
population_count = _count_bits("population_count", "ctpop", [])


@intrinsic
def unlikely(_typing: Any, value: Any) -> Any:
    """Return the boolean itself, with the hint that it is mostly false: its branch is laid out of the way."""
    del value

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return call_intrinsic(builder, "llvm.expect.i1", _I1, [args[0], ir.Constant(_I1, 0)])

    return types.boolean(types.boolean), generate
