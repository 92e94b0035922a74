"""Relighting by a reflectance model alone: `physical` and `phong`."""
