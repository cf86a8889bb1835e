"""Shading: the report's reflection equations, textures, lights, and the facts of a hit that they need."""
