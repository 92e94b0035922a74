"""Avatars from a scan in light that nobody measured: `urhand-phone`, `sh-phone` and their floor, `mean-phone`.

unwrap.py   what the pictures of a fitted hand show of its texture
shadow.py   the seed's way: shadow as a ratio to the mean colour, smooth, divided out
joint.py    the alternative: one light fixed in the world, and the albedo, solved together
usual.py    what is assumed of light times albedo, which pictures alone do not tell apart
method.py   the methods; mean.py: their floor
"""
