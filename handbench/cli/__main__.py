"""`python -m handbench.cli` is `handbench`."""

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
