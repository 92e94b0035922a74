"""Reflectance models and their sums over lights, in tiles or in one fused loop."""
