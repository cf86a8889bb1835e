"""Operators and arithmetic functions on vectors, and on scalars under the same names.

Invariants: IEEE 754 lane by lane; no flag that would let LLVM contract or reassociate. `minimum` and `maximum` are
``a < b ? a : b`` and ``a > b ? a : b``: they return **b** when either is NaN or both are zeros, which is one x86
instruction; the order of the operands therefore says which value survives a NaN.

Source: LLVM language reference.
"""

import operator
from typing import Any

from llvmlite import ir

from tracer.simd.gateway import AbstractTemplate, cgutils, infer_global, intrinsic, lower_builtin, signature, types
from tracer.simd.types import VectorType, broadcast, element_of, is_float, is_number, like, llvm_type, suffix

# operator -> (LLVM builder method on floats, on integers and masks)
_BINARY = {
    operator.add: ("fadd", "add"),
    operator.sub: ("fsub", "sub"),
    operator.mul: ("fmul", "mul"),
    operator.truediv: ("fdiv", None),
    operator.and_: (None, "and_"),
    operator.or_: (None, "or_"),
    operator.xor: (None, "xor"),
    operator.lshift: (None, "shl"),
    operator.rshift: (None, "ashr"),
}
_IN_PLACE = {
    operator.add: operator.iadd,
    operator.sub: operator.isub,
    operator.mul: operator.imul,
    operator.truediv: operator.itruediv,
    operator.and_: operator.iand,
    operator.or_: operator.ior,
    operator.xor: operator.ixor,
    operator.lshift: operator.ilshift,
    operator.rshift: operator.irshift,
}
_COMPARISONS = {
    operator.lt: "<",
    operator.le: "<=",
    operator.gt: ">",
    operator.ge: ">=",
    operator.eq: "==",
    operator.ne: "!=",
}


def call_intrinsic(builder: Any, name: str, result: Any, args: list[Any]) -> Any:
    """Emit a call of an LLVM intrinsic or of a function of libm."""
    kind = ir.FunctionType(result, [arg.type for arg in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


def _operands(builder: Any, sig: Any, args: Any) -> tuple[VectorType, list[Any]]:
    """Both operands as vectors, a scalar one spread over the lanes."""
    vector = next(kind for kind in sig.args if isinstance(kind, VectorType))
    spread = [
        arg if isinstance(kind, VectorType) else broadcast(builder, arg, vector.lanes)
        for kind, arg in zip(sig.args, args, strict=True)
    ]
    return vector, spread


def _register(op: Any, lower: Any, allowed: Any, result: Any) -> None:
    """Teach numba a binary operator on (vector, vector), (vector, scalar) and (scalar, vector)."""

    class Template(AbstractTemplate):  # type: ignore[misc]
        key = op

        def generic(self, args: Any, _kwargs: Any) -> Any:
            if len(args) != 2:
                return None
            left, right = args
            vector = left if isinstance(left, VectorType) else right
            if not isinstance(vector, VectorType) or not allowed(vector):
                return None
            if isinstance(left, VectorType) and isinstance(right, VectorType):
                return signature(result(vector), vector, vector) if left == right else None
            scalar = vector.dtype
            if isinstance(left, VectorType):
                return signature(result(vector), vector, scalar) if isinstance(right, types.Number) else None
            return signature(result(vector), scalar, vector) if isinstance(left, types.Number) else None

    infer_global(op)(Template)
    for left, right in ((VectorType, VectorType), (VectorType, types.Number), (types.Number, VectorType)):
        lower_builtin(op, left, right)(lower)


def _register_binary(op: Any, on_floats: str | None, on_bits: str | None) -> None:
    def lower(_context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector, (left, right) = _operands(builder, sig, args)
        return getattr(builder, str(on_floats if is_float(vector) else on_bits))(left, right)

    def allowed(vector: VectorType) -> bool:
        if is_float(vector):
            return on_floats is not None
        return on_bits is not None and (vector.dtype != types.boolean or on_bits in {"and_", "or_", "xor"})

    _register(op, lower, allowed, lambda vector: vector)
    _register(_IN_PLACE[op], lower, allowed, lambda vector: vector)


def _register_comparison(op: Any, symbol: str) -> None:
    def lower(_context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector, (left, right) = _operands(builder, sig, args)
        if not is_float(vector):
            return builder.icmp_signed(symbol, left, right)
        # a NaN is unequal to all, and neither less nor greater
        compare = builder.fcmp_unordered if symbol == "!=" else builder.fcmp_ordered
        return compare(symbol, left, right)

    _register(op, lower, is_number, lambda vector: vector.mask)


for _op, _methods in _BINARY.items():
    _register_binary(_op, *_methods)
for _op, _symbol in _COMPARISONS.items():
    _register_comparison(_op, _symbol)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, _kwargs: Any) -> Any:
        return signature(args[0], args[0]) if isinstance(args[0], VectorType) and is_number(args[0]) else None


@infer_global(operator.invert)
class _Invert(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, _kwargs: Any) -> Any:
        return signature(args[0], args[0]) if isinstance(args[0], VectorType) and not is_float(args[0]) else None


@lower_builtin(operator.neg, VectorType)
def _lower_negative(_context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0]) if is_float(sig.args[0]) else builder.neg(args[0])


@lower_builtin(operator.invert, VectorType)
def _lower_invert(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
    return builder.not_(args[0])


@intrinsic
def splat(_typing: Any, kind: Any, value: Any) -> Any:
    """``splat(float32x8, x)``: x, cast to the dtype, in every lane. With a scalar type: the cast alone."""
    del value
    target = kind.instance_type

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return broadcast(builder, args[1], target.lanes) if isinstance(target, VectorType) else args[1]

    return target(kind, element_of(target)), generate


def _unary_float(name: str) -> Any:
    def typer(_typing: Any, value: Any) -> Any:
        if not is_float(value):
            return None

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            return call_intrinsic(builder, f"llvm.{name}.{suffix(value)}", llvm_type(value), list(args))

        return value(value), generate

    typer.__name__ = name
    return intrinsic(typer)


# IEEE square root, magnitude (the sign bit cleared) and rounding towards minus infinity; float vectors and scalars.
sqrt = _unary_float("sqrt")
absolute = _unary_float("fabs")
floor = _unary_float("floor")
# The C library's functions, lane by lane: slow, for the rare argument.
libm_sin = _unary_float("sin")
libm_cos = _unary_float("cos")


@intrinsic
def fma(_typing: Any, x: Any, y: Any, z: Any) -> Any:
    """``x * y + z`` rounded once. On a CPU without the instruction libm computes it, lane by lane and slowly."""
    if not (is_float(x) and x == y == z):
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return call_intrinsic(builder, f"llvm.fma.{suffix(x)}", llvm_type(x), list(args))

    return x(x, x, x), generate


@intrinsic
def multiply_add(_typing: Any, x: Any, y: Any, z: Any) -> Any:
    """``x * y + z``, fused where the CPU does that at full speed, else rounded twice: for bounds that hold for both.

    The one operation here whose bits depend on the CPU.
    """
    if not (is_float(x) and x == y == z):
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return call_intrinsic(builder, f"llvm.fmuladd.{suffix(x)}", llvm_type(x), list(args))

    return x(x, x, x), generate


def _choose(name: str, symbol: str) -> Any:
    def typer(_typing: Any, a: Any, b: Any) -> Any:
        if not is_number(a) or a != b:
            return None

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            compare = builder.fcmp_ordered if is_float(a) else builder.icmp_signed
            return builder.select(compare(symbol, *args), *args)

        return a(a, a), generate

    typer.__name__ = name
    return intrinsic(typer)


@intrinsic
def lesser_finite(_typing: Any, a: Any, b: Any) -> Any:
    """Return the smaller of two floats that are not NaN (else the result is undefined; of two zeros, either).

    For read-modify-write: LLVM turns ``store(p, minimum(load(p), x))`` into a masked store, which AMD's CPUs do in
    microcode; it leaves this one a plain minimum.
    """
    if not is_float(a) or a != b:
        return None

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        kind = ir.FunctionType(llvm_type(a), [arg.type for arg in args])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.minnum.{suffix(a)}")
        return builder.call(function, args, fastmath=("nnan", "nsz"))

    return a(a, a), generate


# The smaller and the larger of two: `b` when either is NaN, or when they compare equal (+0 and -0).
minimum = _choose("minimum", "<")
maximum = _choose("maximum", ">")


@intrinsic
def bitcast(_typing: Any, kind: Any, value: Any) -> Any:
    """``bitcast(int32x8, v)``: the same bits as another type of the same size; scalars, too."""
    target = kind.instance_type

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.bitcast(args[1], llvm_type(target))

    return target(kind, value), generate


@intrinsic
def convert(_typing: Any, dtype: Any, value: Any) -> Any:
    """``convert(float64, v)``: the value in another scalar type, lane by lane.

    Floats to integers truncate (the result is undefined outside the integer's range); float64 to float32 rounds to
    nearest; integers widen by sign; booleans become 0 and 1.
    """
    source, goal = element_of(value), dtype.instance_type
    target = like(value, goal)

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        wanted = llvm_type(target)
        if source == goal:
            return args[1]
        if source == types.boolean:
            ones = builder.zext(args[1], llvm_type(like(value, types.int32)))
            if isinstance(goal, types.Integer):
                return ones if goal == types.int32 else builder.zext(args[1], wanted)
            return builder.sitofp(ones, wanted)
        if isinstance(source, types.Float):
            if isinstance(goal, types.Integer):
                return builder.fptosi(args[1], wanted)
            return builder.fpext(args[1], wanted) if goal == types.float64 else builder.fptrunc(args[1], wanted)
        if isinstance(goal, types.Float):
            return builder.sitofp(args[1], wanted)
        return builder.sext(args[1], wanted) if goal.bitwidth > source.bitwidth else builder.trunc(args[1], wanted)

    return target(dtype, value), generate


def _reinterpret(name: str, pairs: dict[Any, Any]) -> Any:
    def typer(_typing: Any, value: Any) -> Any:
        target = pairs.get(element_of(value))
        if target is None:
            return None
        result = like(value, target)

        def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            return builder.bitcast(args[0], llvm_type(result))

        return result(value), generate

    typer.__name__ = name
    return intrinsic(typer)


# The bits of floats as integers of the same size, and back; vectors and scalars.
to_bits = _reinterpret("to_bits", {types.float32: types.int32, types.float64: types.int64})
from_bits = _reinterpret("from_bits", {types.int32: types.float32, types.int64: types.float64})


@intrinsic
def widen(_typing: Any, value: Any) -> Any:
    """float32 as float64; float64 stays. Exact."""
    if not is_float(value):
        return None
    target = like(value, types.float64)

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return args[0] if target == value else builder.fpext(args[0], llvm_type(target))

    return target(value), generate


@intrinsic
def narrow_like(_typing: Any, value: Any, wide: Any) -> Any:
    """Round a float64 result to the float type of ``value``: the way back from :func:`widen`."""

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return args[1] if value == wide else builder.fptrunc(args[1], llvm_type(value))

    return value(value, wide), generate


@intrinsic
def is_single(_typing: Any, value: Any) -> Any:
    """Whether it is float32: a constant, so that only one branch is left in the machine code."""

    def generate(_context: Any, _builder: Any, _sig: Any, _args: Any) -> Any:
        return ir.Constant(ir.IntType(1), int(element_of(value) == types.float32))

    return types.boolean(value), generate


@intrinsic
def shift_right_logical(_typing: Any, value: Any, count: Any) -> Any:
    """Move the bits of integer lanes right by a scalar count, zeros from the left."""
    del count
    scalar = element_of(value)

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        amount = broadcast(builder, args[1], value.lanes) if isinstance(value, VectorType) else args[1]
        return builder.lshr(args[0], amount)

    return value(value, scalar), generate


@intrinsic
def opaque(_typing: Any, value: Any) -> Any:
    """Return the same float64 lanes, but LLVM does not see where they come from; costs nothing.

    It makes one masked store of a load, a select and a store to the same place, and masked stores take 20 cycles and
    more on some CPUs (Zen 2: Fog's tables, VMASKMOVPD), where the three take 3.
    """

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return call_intrinsic(builder, f"llvm.arithmetic.fence.{suffix(value)}", llvm_type(value), list(args))

    return value(value), generate


@intrinsic
def reverse_bits(_typing: Any, value: Any) -> Any:
    """Bits of every integer lane in reverse order."""

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return call_intrinsic(builder, f"llvm.bitreverse.{suffix(value)}", llvm_type(value), list(args))

    return value(value), generate


@intrinsic
def full_like(_typing: Any, value: Any, number: Any) -> Any:
    """``full_like(v, 1.5)``: a literal number in every lane, of v's own type; how generic code writes a constant."""
    del number

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return broadcast(builder, args[1], value.lanes) if isinstance(value, VectorType) else args[1]

    return value(value, element_of(value)), generate
