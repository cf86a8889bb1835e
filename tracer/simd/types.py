"""The vector types, and how LLVM spells them.

Invariants: a vector's data model is the LLVM vector itself (one SSA value, kept in registers); a mask is a vector of
one-bit booleans, whatever its CPU makes of it. A vector never leaves compiled code: it has no Python value.

Source: Numba's extending API; LLVM language reference, "Vector Type".
"""

from typing import Any, Final

from llvmlite import ir

from tracer.simd.gateway import models, register_model, types

POINTER: Final = ir.PointerType()
INDEX: Final = ir.IntType(32)  # what LLVM wants for lane numbers

_ELEMENTS: Final = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: ir.IntType(32),
    types.int64: ir.IntType(64),
    types.boolean: ir.IntType(1),
}


class VectorType(types.Type):  # type: ignore[misc]
    """A numba type: ``lanes`` values of ``dtype``.

    Parameters
    ----------
    dtype
        ``numba.float32``, ``float64``, ``int32``, ``int64`` or ``boolean`` (a mask).
    lanes
        A power of two.
    """

    def __init__(self, dtype: Any, lanes: int) -> None:
        self.dtype = dtype
        self.lanes = lanes
        super().__init__(name=f"simd({dtype} x {lanes})")

    @property
    def mask(self) -> "VectorType":
        """The type of a comparison of two such vectors."""
        return VectorType(types.boolean, self.lanes)

    def with_dtype(self, dtype: Any) -> "VectorType":
        """Return the vector type with as many lanes of another dtype."""
        return VectorType(dtype, self.lanes)

    def with_lanes(self, lanes: int) -> "VectorType":
        """Return the vector type with another number of lanes of the same dtype."""
        return VectorType(self.dtype, lanes)


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    """A vector is one LLVM value."""

    def __init__(self, dmm: Any, fe_type: VectorType) -> None:
        super().__init__(dmm, fe_type, llvm_type(fe_type))


float32x4: Final = VectorType(types.float32, 4)
float32x8: Final = VectorType(types.float32, 8)
float32x16: Final = VectorType(types.float32, 16)
float64x4: Final = VectorType(types.float64, 4)
float64x8: Final = VectorType(types.float64, 8)
int32x4: Final = VectorType(types.int32, 4)
int32x8: Final = VectorType(types.int32, 8)
int32x16: Final = VectorType(types.int32, 16)
int64x4: Final = VectorType(types.int64, 4)
int64x8: Final = VectorType(types.int64, 8)
mask4: Final = VectorType(types.boolean, 4)
mask8: Final = VectorType(types.boolean, 8)
mask16: Final = VectorType(types.boolean, 16)


def element_of(kind: Any) -> Any:
    """Return the scalar type of a vector or scalar type."""
    return kind.dtype if isinstance(kind, VectorType) else kind


def like(kind: Any, dtype: Any) -> Any:
    """Return the type of ``kind``'s shape (scalar, or so many lanes) with another scalar type."""
    return kind.with_dtype(dtype) if isinstance(kind, VectorType) else dtype


def is_float(kind: Any) -> bool:
    """Whether it is a float scalar or a vector of floats."""
    return isinstance(element_of(kind), types.Float)


def is_number(kind: Any) -> bool:
    """Whether it is a float or integer scalar, or a vector of those."""
    return isinstance(element_of(kind), types.Float | types.Integer)


def llvm_element(dtype: Any) -> Any:
    """LLVM's name of a scalar type."""
    return _ELEMENTS[dtype]


def llvm_type(kind: Any) -> Any:
    """LLVM's name of a vector or scalar type."""
    element = llvm_element(element_of(kind))
    return ir.VectorType(element, kind.lanes) if isinstance(kind, VectorType) else element


def suffix(kind: Any) -> str:
    """Return the overload suffix of an LLVM intrinsic, such as ``v8f32`` or ``f64``."""
    element = element_of(kind)
    letter = f"{'f' if isinstance(element, types.Float) else 'i'}{llvm_bits(element)}"
    return f"v{kind.lanes}{letter}" if isinstance(kind, VectorType) else letter


def llvm_bits(dtype: Any) -> int:
    """Bits of a scalar type in a register: 1 for a boolean."""
    return 1 if dtype == types.boolean else int(dtype.bitwidth)


def constant(kind: Any, value: float) -> Any:
    """Make an LLVM constant with the same value in every lane."""
    if isinstance(kind, VectorType):
        element = llvm_element(kind.dtype)
        return ir.Constant(llvm_type(kind), [ir.Constant(element, value)] * kind.lanes)
    return ir.Constant(llvm_type(kind), value)


def lane_numbers(numbers: list[int]) -> Any:
    """Make a constant vector of lane numbers, as a shuffle wants them."""
    return ir.Constant(ir.VectorType(INDEX, len(numbers)), [ir.Constant(INDEX, number) for number in numbers])


def broadcast(builder: Any, scalar: Any, lanes: int) -> Any:
    """Emit a vector with ``scalar`` in every lane."""
    undefined = ir.Constant(ir.VectorType(scalar.type, lanes), ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(INDEX, 0))
    return builder.shuffle_vector(first, undefined, lane_numbers([0] * lanes))


def shuffle(builder: Any, value: Any, numbers: list[int]) -> Any:
    """Emit the lanes of one vector in the constant order ``numbers``."""
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), lane_numbers(numbers))
