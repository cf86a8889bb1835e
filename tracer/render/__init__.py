"""Rendering: the backend seam, the kernel's loop over blocks, the compiler of scenes and its cache."""

from tracer.render.backend import Backend, Canceled, get_backend
from tracer.render.cache import compile_cached
from tracer.render.compile import CompileStats, compile_scene
from tracer.render.frame import Film, Progress, list_blocks, render_compiled, render_scene

__all__ = [
    "Backend",
    "Canceled",
    "CompileStats",
    "Film",
    "Progress",
    "compile_cached",
    "compile_scene",
    "get_backend",
    "list_blocks",
    "render_compiled",
    "render_scene",
]
