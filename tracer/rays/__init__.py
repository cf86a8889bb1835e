"""Rays: where they start, at the camera and on surfaces."""
