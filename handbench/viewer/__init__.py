"""A live viewer on this machine: avatars relit while cameras and lights are turned.

session.py    draws what the page asks for, and keeps poses
server.py     serves the page and its pictures, to this machine alone
page/         the page
"""
