"""Geometry: vectors, rounding bounds, and the ray's meeting with each primitive."""
