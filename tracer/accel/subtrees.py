"""One subtree of a mesh, from its records to the plan of its wide nodes, in memory that the cache holds."""

from typing import Any, Final

import numpy as np

from tracer.accel.binary import bound_records, build_binary
from tracer.accel.collapse import measure, plan_nodes
from tracer.accel.layout import STOP
from tracer.jit import kernel
from tracer.simd import address_of, float32x8, load, store
from tracer.simd.gateway import types

_int32: Final = types.int32


@kernel
def build_subtree(
    records: Any, start: int, end: int, depth: int, nodes: Any, costs: Any, plan: Any, value_bytes: int
) -> Any:
    """Build the binary tree over some records and plan its wide nodes.

    Parameters
    ----------
    records
        float32 (n, 8); those of rows start..end are reordered.
    start, end
        Which.
    depth
        Of the root, below the whole tree's.
    nodes, costs, plan
        float32 (m, 8), float32 (m, 8) and int32 (m, 4) with m > 2 (end - start): receive the binary nodes from row 0
        on, anything, and the plan.
    value_bytes
        Of a leaf's coordinate.

    Returns
    -------
    tuple of int
        (bytes, wide nodes, depth) of the wide tree, as `tracer.accel.collapse.measure`.
    """
    bounds = np.empty((2, 8), np.float32)
    bound_records(records, start, end, bounds)
    node = address_of(nodes)
    store(node, load(float32x8, address_of(bounds)))
    store(node + 12, _int32(start))
    store(node + 28, _int32(end - start))
    n_nodes, _ = build_binary(records, nodes, 0, depth, bounds[1], 1, STOP, np.empty((0, 2), np.int64))
    plan_nodes(nodes, n_nodes, costs, plan)
    return measure(nodes, plan, value_bytes)
