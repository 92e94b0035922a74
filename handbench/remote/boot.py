"""Started by the other interpreter as a script: makes this very `handbench` importable there, then serves.

Only the package is made known, not the folder it is installed in: what else lies there must stay out of sight.
Arguments: one JSON object with `handbench` (folders of the package), `path` (folders of the method), `socket`.
"""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import sys
import threading
from pathlib import Path


def _make_known(places: list[str]) -> None:
    init = Path(places[0], "__init__.py")
    spec = importlib.util.spec_from_file_location("handbench", init, submodule_search_locations=places)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["handbench"] = module
    spec.loader.exec_module(module)


def _end_with_parent() -> None:
    """Standard input never says anything; its end is the end of the process that started this one."""
    os.read(0, 1)
    os._exit(1)


def main() -> None:
    if sys.version_info < (3, 11):  # noqa: UP036 - whatever interpreter was named runs this
        sys.exit("Python {}.{} is too old; handbench needs 3.11".format(*sys.version_info))
    told = json.loads(sys.argv[1])
    here = Path(__file__).resolve().parent  # on the path because this is a script
    sys.path[:] = told["path"] + [place for place in sys.path if Path(place or ".").resolve() != here]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _make_known(told["handbench"])
    from handbench.remote.wire import Channel
    from handbench.remote.worker import serve

    serve(Channel(socket.socket(fileno=told["socket"])))


if __name__ == "__main__":
    main()
