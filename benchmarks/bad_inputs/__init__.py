"""Bad inputs over every verb and format, from a seeded generator: `python -m benchmarks.bad_inputs`.

case.py          what is tried, what came of it, and the verdict
mutate.py        how sound files are spoiled: bytes, texts, JSON values
bases.py         sound inputs, made once
families.py      the table of families: protocols, runs, pictures, maps, prediction folders, captures, command lines
surroundings.py  encodings, closed and full streams, signals, odd environments: a process each
worker.py        the process that tries cases one after another; runner.py starts, times (clock.py) and replaces it
"""
