"""Methods that run in a Python interpreter of their own, because their dependencies fit no other.

    def create(preset="quick"):     # what an entry of your package points to
        return remote_method(preset, python="/envs/theirs/bin/python", target="theirs:create")

method.py   what the bench calls: a `Method` whose work is done by a worker process
process.py  the worker process: started, asked, watched, killed
worker.py   what runs over there; boot.py starts it with nothing but numpy and this package's folder
wire.py     messages between the two: JSON and raw arrays
faults.py   exceptions as values
"""

from .method import remote_method

__all__ = ["remote_method"]
