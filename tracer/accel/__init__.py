"""Acceleration structures: building and traversing the bounding volume hierarchies."""

from tracer.accel.top import Placement, build_bvh, build_tree, join_hierarchies

__all__ = ["Placement", "build_bvh", "build_tree", "join_hierarchies"]
