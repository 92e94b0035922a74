"""Surfaces in UV space: atlases, normals, and posed surfaces with their shadows."""
