"""Pure rendering: scene document to compiled scene to pixels.

Nothing here knows of a network, a queue or a log. Importing this package loads nothing heavy: numba comes in with
the kernels, trimesh with the loaders, OpenImageIO with the film's images.
"""
