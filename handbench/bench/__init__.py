"""Plan, run, store, provenance.

protocol.py   what a protocol says, applied to a capture's frames
plan.py       protocol, methods and seeds to cells and their keys
run.py        every missing cell, through cell.py and priors.py
store.py      the run folder: append-only, whole or absent
check.py      the laws of `handbench.method`, tried on a method
"""
