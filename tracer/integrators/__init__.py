"""Integrators: the colour that comes back along a ray."""
