"""Rendering: the backend seam, the compiler of scenes and its cache."""
