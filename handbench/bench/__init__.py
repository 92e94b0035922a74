"""Plan, run, store, provenance.

protocol.py   what a protocol says, applied to a capture's frames
plan.py       protocol, methods and seeds to cells and their keys
source.py     what a plug-in is made of, for the keys
run.py        every missing cell
executor.py   the loop over cells that all processes of a run go through; cluster.py sends it to Ray
cell.py       one cell, with its training from priors.py
store.py      the run folder: append-only, whole or absent
opening.py    a protocol's data; reopening.py: the protocol and data that a kept run is of
describe.py   what run.json and the cells' files say; provenance.py: where it comes from
check.py      the laws of `handbench.method`, tried on a method
"""
