"""`handbench stress`: hard cases with their expected outcome, each tried in a process that may die or hang.

run.py        the public function
suite.py      the declared cases, family by family (`cases_*.py`)
outcome.py    what may be expected of a case, and whether what was observed is that
runner.py     worker processes with a time limit a case
record.py     stress.json and the table for a terminal
"""
