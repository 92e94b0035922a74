"""handbench view: avatars relit live in the browser."""

from __future__ import annotations

import argparse
from typing import Any

from ..terminal import complain, say
from .relight import add_avatars, portraits, size
from .shared import examples, port


def add(verbs: Any) -> None:
    view = verbs.add_parser(
        "view",
        help="relight avatars live in the browser: turn camera and light, pick poses and maps, compare",
    )
    add_avatars(view)
    view.add_argument("--light", action="append", metavar="MAP", help="maps beside the ten sky boxes")
    view.add_argument("--size", type=size, default=(256, 342), metavar="WxH", help="of a picture (default: 256x342)")
    view.add_argument("--port", type=port, default=0, metavar="N", help="(default: any that is free)")
    view.add_argument("--open", action="store_true", help="open the page in the browser")
    examples(
        view,
        "view me.avatar --open",
        "view one.avatar other.avatar --light studio.exr",
        "view --run runs/quick --methods urhand,physical --subject s05",
        below="The page is for this machine alone (127.0.0.1). Ctrl-C ends it.",
    )
    view.set_defaults(verb=_view)


def _view(arguments: argparse.Namespace) -> int:
    from ..bench.progress import steps
    from ..data.lights import NamedLight
    from ..device import on_device
    from ..light.skybox import SKYBOXES
    from ..viewer.server import Server
    from ..viewer.session import Session

    lights = [NamedLight.parse(text) for text in arguments.light or []]
    for light in lights:
        light.read(complain)
    named = (*lights, *(NamedLight(name) for name in SKYBOXES))
    with on_device(arguments.device):
        with steps() as told:
            shown = portraits(arguments, told)
        with Server(Session(shown, named, arguments.size), arguments.port) as server:
            say(f"{', '.join(portrait.name for portrait in shown)}: {server.address} (Ctrl-C ends it)")
            if arguments.open:
                import webbrowser

                webbrowser.open(server.address)
            try:
                server.serve_forever(poll_interval=0.2)
            except KeyboardInterrupt:  # the usual end
                say()
    return 0
