"""`python -m handbench.cli` is `handbench`."""

from . import command

if __name__ == "__main__":
    command()
