"""Errors of geometry: surfaces, depth and normal maps, silhouettes, points, and errors that flicker over time.

Nothing is aligned before it is measured; lengths are reported in millimetres.
"""
