"""Sample positions as pure functions of (seed, pixel, sample, dimension)."""
