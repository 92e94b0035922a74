"""Speed on this machine, and other things that are measured and no test; see README.md."""

import handbench  # noqa: F401, before torch, as in a run: it says how torch's threads wait
