"""Loaders: files that someone else wrote, on their way to checked arrays.

`guard` starts a process of its own for each batch of files and hands the arrays back; `__main__` is what runs in it.
Importing this package loads nothing heavy; trimesh is only ever imported in the guarded process.
"""
