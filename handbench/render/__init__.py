"""Rays, UV atlas, reflectance, shading, camera rasterisation, the path-traced reference."""
