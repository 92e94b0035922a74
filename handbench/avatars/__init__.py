"""Avatars as values that can be kept, shown and given away.

repertoire.py   the poses and cameras that an avatar can be shown in
portrait.py     an avatar with its method, its repertoire, and what must be known of it
folder.py       a portrait on disk: written whole, checked when it is read
making.py       portraits from a run, and from a capture of one's own
"""
