"""The slab test of a node: both children's boxes at once, in four lanes.

A box's interval is [max near, min far]. With the far parameters negated all four lanes (near 0, near 1, far 0, far
1) take the same steps: subtract, multiply, keep the larger. A comparison with NaN is False, so a plane across which
the ray does not move and in which it starts leaves the interval as it is.

Sources: Kay and Kajiya 1986; Williams et al. 2005 (planes chosen by sign).
"""

import math
from typing import Any, Final, NamedTuple

import numba
from llvmlite import ir

from tracer.geometry.rounding import EPSILON, gamma
from tracer.jit import PLAIN_PYTHON, inline
from tracer.types import Vec3

# Roundings that the padding of boxes covers, as a multiple of eps times the distance from the origin to the
# farthest corner of the scene: 3 in each of two slab parameters and 2 in their pads, 5 in the shear of a vertex
# (coordinate difference, slope, product, sum, and the slope again along z), the rest for the affine maps of shapes.
# It is 1e-14 of the scene: no box is visited for it.
_PAD: Final = gamma(64)


class Slabs(NamedTuple):
    """A ray as boxes see it."""

    near_x: float  # origin, padded towards the near planes
    near_y: float
    near_z: float
    far_x: float  # origin, padded towards the far planes
    far_y: float
    far_z: float
    inverse_x: float  # 1 / direction
    inverse_y: float
    inverse_z: float
    sign_x: int  # 0, or 1 where the direction is negative (-0 included)
    sign_y: int
    sign_z: int


class Spans(NamedTuple):
    """Where a ray enters and leaves a node's two boxes; it misses a box where it would leave before it enters."""

    near0: float
    near1: float
    far0: float
    far1: float


@inline
def make_slabs(root: Any, o: Vec3, d: Vec3) -> Slabs:
    """Prepare a ray for the boxes of a scene with bounds ``root`` (flat: lower, upper corner)."""
    reach_x = max(abs(root[0] - o.x), abs(root[3] - o.x))
    reach_y = max(abs(root[1] - o.y), abs(root[4] - o.y))
    reach_z = max(abs(root[2] - o.z), abs(root[5] - o.z))
    pad = _PAD * max(reach_x, reach_y, reach_z)
    # 2 eps |o| more, or the sum's own rounding would swallow the padding far from the world's origin.
    pad_x = math.copysign(pad + 2.0 * EPSILON * abs(o.x), d.x)
    pad_y = math.copysign(pad + 2.0 * EPSILON * abs(o.y), d.y)
    pad_z = math.copysign(pad + 2.0 * EPSILON * abs(o.z), d.z)
    return Slabs(
        o.x + pad_x,
        o.y + pad_y,
        o.z + pad_z,
        o.x - pad_x,
        o.y - pad_y,
        o.z - pad_z,
        1.0 / d.x,
        1.0 / d.y,
        1.0 / d.z,
        0 if math.copysign(1.0, d.x) > 0.0 else 1,
        0 if math.copysign(1.0, d.y) > 0.0 else 1,
        0 if math.copysign(1.0, d.z) > 0.0 else 1,
    )


if PLAIN_PYTHON:

    def _four_lanes(bounds: Any, node: Any, nears: Any, fars: Any, inverses: Any, signs: Any, end: Any) -> Any:
        """Do the same as the compiled one, lane by lane."""
        best = [0.0, 0.0, -end, -end]
        for axis in range(3):
            for lane in range(4):
                plane = 2 * signs[axis] if lane < 2 else 2 - 2 * signs[axis]
                origin, scale = (nears[axis], inverses[axis]) if lane < 2 else (fars[axis], -inverses[axis])
                t = (bounds[12 * node + 4 * axis + plane + lane % 2] - origin) * scale
                best[lane] = t if t > best[lane] else best[lane]  # noqa: FURB136 - max() has no defined NaN rule
        return best[0], best[1], -best[2], -best[3]

else:

    @numba.extending.intrinsic
    def _four_lanes(
        _context: Any, bounds: Any, _node: Any, _nears: Any, _fars: Any, _inverses: Any, signs: Any, _end: Any
    ) -> Any:
        """Spans of both boxes of a node, as (near 0, near 1, far 0, far 1), in explicit vector instructions."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address, index, near_o, far_o, inverse, sign, t_max = arguments
            double, word, lane_index = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
            two, four = ir.VectorType(double, 2), ir.VectorType(double, 4)
            all_lanes = ir.Constant(ir.VectorType(lane_index, 4), [0, 1, 2, 3])

            def fill(near: Any, far: Any) -> Any:
                vector = ir.Constant(four, ir.Undefined)
                for lane, value in enumerate((near, near, far, far)):
                    vector = builder.insert_element(vector, value, ir.Constant(lane_index, lane))
                return vector

            def load_planes(at: Any) -> Any:
                return builder.load(builder.bitcast(builder.gep(address, [at]), two.as_pointer()), align=8)

            first = builder.mul(index, ir.Constant(word, 12))
            best = fill(ir.Constant(double, 0.0), builder.fneg(t_max))
            for axis in range(3):
                shift = builder.shl(builder.extract_value(sign, axis), ir.Constant(word, 1))
                near = load_planes(builder.add(first, shift))
                far = load_planes(builder.sub(builder.add(first, ir.Constant(word, 2)), shift))
                first = builder.add(first, ir.Constant(word, 4))
                origin = fill(builder.extract_value(near_o, axis), builder.extract_value(far_o, axis))
                scale = builder.extract_value(inverse, axis)
                offset = builder.fsub(builder.shuffle_vector(near, far, all_lanes), origin)
                t = builder.fmul(offset, fill(scale, builder.fneg(scale)))
                best = builder.select(builder.fcmp_ordered(">", t, best), t, best)
            values = [builder.extract_element(best, ir.Constant(lane_index, lane)) for lane in range(4)]
            spans = [values[0], values[1], builder.fneg(values[2]), builder.fneg(values[3])]
            return context.make_tuple(builder, signature.return_type, spans)

        types: Any = numba.types
        three = types.UniTuple(types.float64, 3)
        arguments = (bounds, types.int64, three, three, three, signs, types.float64)
        return types.UniTuple(types.float64, 4)(*arguments), generate


@inline
def enter_children(bounds: Any, node: int, ray: Slabs, t_max: float) -> Spans:
    """Find where a ray is inside the two boxes of a node, within 0 <= t <= t_max.

    Parameters
    ----------
    bounds : flat float64
        ``bvh_bounds`` of :class:`tracer.types.CompiledScene`.
    node : int
        Whose children to test.
    ray, t_max
        The ray; its end.

    Returns
    -------
    Spans
        Conservative: a box that the exact ray meets has near <= far, and near is not after the exact entry.
    """
    near0, near1, far0, far1 = _four_lanes(
        bounds,
        node,
        (ray.near_x, ray.near_y, ray.near_z),
        (ray.far_x, ray.far_y, ray.far_z),
        (ray.inverse_x, ray.inverse_y, ray.inverse_z),
        (ray.sign_x, ray.sign_y, ray.sign_z),
        t_max,
    )
    return Spans(near0, near1, far0, far1)
