"""The HTTP service: routes, schemas, errors and events. This process never loads numba."""
