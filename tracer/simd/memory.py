"""Addresses, loads and stores, memory on the stack, gather.

An address is an integer (``int64``) of bytes: kernels compute offsets into packed nodes with it, and LLVM folds them
into its addressing modes. The caller keeps the array alive and stays inside it.

Invariants: a load or store needs no more than the element's own alignment, so it never faults on a packed layout;
`stack_memory` is allocated once in the function's entry block, whatever loop it is written in (``np.empty`` in a ray
costs half the speed).
"""

from typing import Any

from llvmlite import ir

from tracer.simd.arithmetic import call_intrinsic
from tracer.simd.gateway import cgutils, intrinsic, types
from tracer.simd.types import (
    INDEX,
    POINTER,
    VectorType,
    broadcast,
    constant,
    element_of,
    like,
    llvm_bits,
    llvm_type,
    suffix,
)

_I8 = ir.IntType(8)
_I64 = ir.IntType(64)
_CACHE_LINE = 64


@intrinsic
def address_of(_typing: Any, array: Any) -> Any:
    """Return the address of a C-contiguous array's first element, or that which a pointer holds, as int64."""
    if isinstance(array, types.CPointer):

        def convert(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
            return builder.ptrtoint(args[0], _I64)

        return types.int64(array), convert
    if not isinstance(array, types.Array) or array.layout != "C":
        return None

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.ptrtoint(data, _I64)

    return types.int64(array), generate


@intrinsic
def load_as_float64(_typing: Any, shape: Any, kind: Any, address: Any) -> Any:
    """``load_as_float64(float64x4, kind, address)``: as many consecutive values of a scalar type, widened.

    With a scalar in the place of the shape: one value.
    """
    del address
    target = shape.instance_type
    source = like(target, kind.instance_type)

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        value = builder.load(builder.inttoptr(args[2], POINTER), align=_align(source), typ=llvm_type(source))
        return value if source == target else builder.fpext(value, llvm_type(target))

    return target(shape, kind, types.int64), generate


def _align(kind: Any) -> int:
    return max(1, llvm_bits(element_of(kind)) // 8)


@intrinsic
def load(_typing: Any, kind: Any, address: Any) -> Any:
    """``load(float32x8, address)``: consecutive values from memory; a scalar type loads one."""
    del address
    target = kind.instance_type

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        return builder.load(builder.inttoptr(args[1], POINTER), align=_align(target), typ=llvm_type(target))

    return target(kind, types.int64), generate


@intrinsic
def store(_typing: Any, address: Any, value: Any) -> Any:
    """Write a vector's lanes, or a scalar of its own type, to consecutive memory."""
    del address

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        builder.store(args[1], builder.inttoptr(args[0], POINTER), align=_align(value))

    return types.void(types.int64, value), generate


@intrinsic
def prefetch(_typing: Any, address: Any) -> Any:
    """Ask for the cache line at an address; any address is allowed."""
    del address

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        options = [ir.Constant(INDEX, number) for number in (0, 3, 1)]  # read, keep in all levels, data
        call_intrinsic(builder, "llvm.prefetch.p0", ir.VoidType(), [builder.inttoptr(args[0], POINTER), *options])

    return types.void(types.int64), generate


@intrinsic(prefer_literal=True)
def stack_memory(_typing: Any, size: Any) -> Any:
    """``stack_memory(256)``: the address of so many bytes on the stack, aligned to 64, until the function returns.

    The size must be a literal or a module's constant. Uninitialised.
    """
    if not isinstance(size, types.IntegerLiteral):
        return None

    def generate(_context: Any, builder: Any, _sig: Any, _args: Any) -> Any:
        with builder.goto_entry_block():
            memory = builder.alloca(ir.ArrayType(_I8, size.literal_value))
            memory.align = 64
        return builder.ptrtoint(memory, _I64)

    return types.int64(size), generate


def constant_table(name: str, data: bytes) -> Any:
    """Make an intrinsic without arguments that returns the address of constant bytes, on a cache line."""
    symbol = f"smalti.simd.{name}"

    @intrinsic
    def table(_typing: Any) -> Any:
        def generate(_context: Any, builder: Any, _sig: Any, _args: Any) -> Any:
            found = builder.module.globals.get(symbol)
            if found is None:
                found = cgutils.global_constant(builder, symbol, cgutils.make_bytearray(data))
                found.align = _CACHE_LINE
            return builder.ptrtoint(found, _I64)

        return types.int64(), generate

    return table


@intrinsic
def gather(_typing: Any, kind: Any, base: Any, index: Any, mask: Any) -> Any:
    """``gather(float32x8, address, index, mask)``: lane ``i`` is element ``index[i]`` of the array at the address.

    ``index`` counts elements (int32 or int64 lanes); lanes whose mask is not set read nothing and are 0.
    """
    del base
    target = kind.instance_type
    if not isinstance(target, VectorType) or mask != target.mask:
        return None
    size = llvm_bits(target.dtype) // 8

    def generate(_context: Any, builder: Any, _sig: Any, args: Any) -> Any:
        _kind, start, number, chosen = args
        wide = ir.VectorType(_I64, target.lanes)
        if number.type.element != _I64:
            number = builder.sext(number, wide)
        offset = builder.mul(number, ir.Constant(wide, [ir.Constant(_I64, size)] * target.lanes))
        addresses = builder.add(broadcast(builder, start, target.lanes), offset)
        pointers = builder.inttoptr(addresses, ir.VectorType(POINTER, target.lanes))
        zero = constant(target, 0.0 if isinstance(target.dtype, types.Float) else 0)
        name = f"llvm.masked.gather.{suffix(target)}.v{target.lanes}p0"
        return call_intrinsic(builder, name, llvm_type(target), [pointers, ir.Constant(INDEX, size), chosen, zero])

    return target(kind, types.int64, index, mask), generate


@intrinsic
def stand_alone(_typing: Any) -> Any:
    """Keep LLVM from copying the function that this is called in into its callers.

    For large functions: their registers and their place in a profile stay their own, and they are compiled once.
    """

    def generate(_context: Any, builder: Any, _sig: Any, _args: Any) -> Any:
        builder.function.attributes.add("noinline")

    return types.void(), generate
