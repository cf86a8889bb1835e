"""Kernels as native code, without the compiler: an image that `smalti warm` makes once, and processes map.

Importing numba takes longer than a small picture. So the kernels that Python calls (`tracer.native.entries`) are
compiled ahead, by numba, into one file of machine code beside numba's own cache; a process that finds it imports
neither numba nor a kernel's module. Without an image an entry is the kernel that numba compiles: the same code.

Invariants: nothing here but `build` imports numba; an image is named by all that decides its code (`key`), so it is
never stale, and serves every clone of these sources.
"""
