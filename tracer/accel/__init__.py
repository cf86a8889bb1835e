"""Acceleration structures: building and traversing the bounding volume hierarchy."""

from tracer.accel.build import build_bvh

__all__ = ["build_bvh"]
