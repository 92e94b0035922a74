"""Avatars relit: stills, turning lights, turning cameras, sequences of poses, several avatars side by side.

shots.py      what is asked for, as one viewpoint and light a frame
drawing.py    draws the frames, with the clock on; what is drawn is kept, so a stopped relighting goes on
showing.py    one exposure for all frames, avatars beside each other, and how much they flicker
video.py      frames as .mp4, .gif, or a folder of pictures
"""
