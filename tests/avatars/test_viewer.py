"""The live viewer: what it draws, whom it answers, and the page in a browser."""

from __future__ import annotations

import io
import json
import re
import shutil
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from http.client import HTTPConnection
from typing import Any

import numpy as np
import pytest
from PIL import Image

from handbench.avatars.portrait import Portrait
from handbench.data.lights import NamedLight
from handbench.errors import InputError
from handbench.method import Avatar, PosedAvatar
from handbench.scene import Viewpoint
from handbench.viewer.server import Server
from handbench.viewer.session import Glance, Session


@pytest.fixture(scope="module")
def session(portrait: Portrait) -> Session:
    avatar = type(portrait.avatar)(0.5 * portrait.avatar._texture, portrait.prior)  # type: ignore
    other = replace(portrait, name="<b>dim</b>", avatar=avatar)
    return Session([portrait, other], [NamedLight("hall"), NamedLight("park")], (48, 64))


@pytest.fixture(scope="module")
def server(session: Session) -> Iterator[Server]:
    with Server(session) as found:
        thread = threading.Thread(target=found.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        thread.start()
        yield found
        found.shutdown()
        thread.join()


def opened(jpeg: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(jpeg))).astype(float)


def test_pictures_follow_the_view(session: Session) -> None:
    front = opened(session.draw(Glance(0)).jpeg)
    assert front.shape == (64, 48, 3) and 190 < np.percentile(front, 99.5) <= 255
    assert opened(session.draw(Glance(1)).jpeg).mean() < 0.9 * front.mean()  # one exposure for both
    for view in (Glance(0, yaw=60), Glance(0, turn=120), Glance(0, light=1), Glance(0, pose=1), Glance(0, exposure=-1)):
        assert np.abs(opened(session.draw(view).jpeg) - front).mean() > 1.0, view
    assert np.array_equal(opened(session.draw(Glance(0)).jpeg), front)  # back where it began
    assert opened(session.thumbnail(0, 90.0)).shape == (64, 128, 3)


def test_drafts_show_the_same_in_half_as_many_pixels_both_ways(session: Session) -> None:
    view = Glance(0, pose=1, yaw=30, zoom=1.2, turn=40)
    whole, draft = (opened(session.draw(replace(view, draft=d)).jpeg) for d in (0, 1))
    assert whole.shape == (64, 48, 3) and draft.shape == (32, 24, 3)
    halved = whole.reshape(32, 2, 24, 2, 3).mean((1, 3))
    assert np.abs(halved - draft).mean() < 0.25 * np.abs(halved - draft[:, ::-1]).mean()


def test_poses_shown_last_are_kept(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    posed: list[str] = []
    first = session.portraits[0]
    anew = type(first.avatar).pose

    def pose(avatar: Avatar, viewpoint: Viewpoint) -> PosedAvatar:
        posed.append(viewpoint.pose_name)
        return anew(avatar, viewpoint)  # type: ignore[arg-type]

    monkeypatch.setattr(type(first.avatar), "pose", pose)
    for kept, expected in ((2, ["rest", "turned"]), (1, ["rest", "turned", "rest", "turned"])):
        posed.clear()
        fresh = Session([first], session.lights, session.size, kept)
        for number, turn in enumerate((0.0, 0.0, 30.0, 30.0)):
            fresh.draw(Glance(0, pose=number % 2, turn=turn, yaw=turn))
        assert posed == expected


ABSENT = {"avatar": 2, "pose": 9, "light": -1, "zoom": 0.0, "exposure": 99, "draft": 2}


@pytest.mark.parametrize("view", [replace(Glance(0), **{name: value}) for name, value in ABSENT.items()])
def test_numbers_that_there_are_not_are_told(session: Session, view: Glance) -> None:
    with pytest.raises(InputError, match="give"):
        session.draw(view)


def asked(server: Server, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, headers=given)
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return found


def test_it_serves_its_own_files_and_pictures(server: Server) -> None:
    status, headers, body = asked(server, "/")
    assert status == 200 and b"viewer.js" in body and "default-src 'none'" in headers["Content-Security-Policy"]
    assert [asked(server, path)[0] for path in ("/viewer.js", "/viewer.css", "/state")] == [200] * 3
    state = json.loads(asked(server, "/state")[2])
    assert [avatar["name"] for avatar in state["avatars"]] == ["toy", "<b>dim</b>"]
    assert state["lights"] == ["hall", "park"] and state["avatars"][0]["poses"] == ["rest", "turned"]
    status, headers, body = asked(server, "/picture?avatar=1&yaw=20&turn=30")
    assert status == 200 and float(headers["X-Milliseconds"]) > 0 and opened(body).shape == (64, 48, 3)
    assert server.server_address[0] == "127.0.0.1"


def test_a_picture_does_not_wait_for_its_headers_to_be_acknowledged(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Headers and picture are two writes: the system would hold the second back for 40 ms."""
    handler, found = server.RequestHandlerClass, []
    answer = handler.do_GET  # type: ignore[attr-defined]

    def looked_at(self: Any) -> None:
        found.append(self.connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
        answer(self)

    monkeypatch.setattr(handler, "do_GET", looked_at)
    assert asked(server, "/picture?avatar=0")[0] == 200 and found[0] != 0


@pytest.mark.parametrize(
    "path",
    ["/../server.py", "/page/index.html", "/etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/viewer.js/"],
)
def test_nothing_else_is_served(server: Server, path: str) -> None:
    assert asked(server, path)[0] == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1:1"},
        {"Host": "evil.example@127.0.0.1"},
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_others_are_refused(server: Server, headers: dict[str, str]) -> None:
    for path in ("/", "/state", "/picture?avatar=0"):
        status, told, body = asked(server, path, **headers)
        assert status == 403 and body.startswith(b"refused") and "Access-Control-Allow-Origin" not in told


def test_its_own_page_is_answered(server: Server) -> None:
    for host in (f"127.0.0.1:{server.server_port}", f"localhost:{server.server_port}"):
        assert asked(server, "/state", Host=host, Origin=f"http://{host}", Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("/picture?avatar=7", "no avatar 7"),
        ("/picture", "of an avatar"),
        ("/picture?avatar=0&yaw=nan", "yaw is 'nan'"),
        ("/picture?avatar=0&yaw=1e400", "give a number"),
        ("/picture?avatar=0.5", "give a number"),
        ("/picture?avatar=0&evil=1", "unknown part of a view"),
        ("/picture?" + "&".join("avatar=0" for _ in range(50)), ""),
    ],
)
def test_bad_requests_get_a_sentence(server: Server, path: str, message: str) -> None:
    status, _, body = asked(server, path)
    assert status == 422 and message in json.loads(body)["error"]


def test_a_page_that_has_gone_is_no_fault(server: Server, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", server.server_port)) as gone:
        gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # closing resets
        gone.sendall(b"GET / HT")
        time.sleep(0.2)
    time.sleep(0.3)
    assert asked(server, "/state")[0] == 200
    assert capfd.readouterr().err == ""


def test_other_methods_and_a_taken_port(server: Server, session: Session) -> None:
    assert asked(server, "/state", method="POST")[0] in (405, 501)
    with pytest.raises(InputError, match=f"port {server.server_port} cannot be used.*--port"):
        Server(session, server.server_port)


def test_the_page_by_keyboard(server: Server) -> None:
    sync = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    chromium = next((found for name in names if (found := shutil.which(name))), None)
    if chromium is None:
        pytest.skip("no Chromium is installed")
    with sync.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1100, "height": 900})
        troubles: list[str] = []
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("console", lambda said: troubles.append(said.text) if said.type == "error" else None)
        page.on(
            "request",
            lambda request: (
                troubles.append(request.url)
                if "127.0.0.1" not in request.url and not request.url.startswith("blob:")
                else None
            ),
        )
        page.goto(server.address)
        pictures = page.locator("canvas")
        drawn = "() => [...document.querySelectorAll('canvas')].map((c) => Number(c.dataset.count || 0))"

        def settled(before: list[int]) -> list[int]:
            page.wait_for_function(
                f"(before) => ({drawn})().every((n, i) => n > before[i])", arg=before, timeout=60_000
            )
            return page.evaluate(drawn)

        count = settled([0, 0])
        assert pictures.count() == 2 and "<b>dim</b>" in page.locator("figcaption").nth(1).inner_text()
        page.focus("#stage")
        for key, output, shown in (
            ("ArrowRight", "#yaw-out", "5°"),
            ("ArrowUp", "#pitch-out", "5°"),
            ("Shift+ArrowRight", "#turn-out", "5°"),
            ("e", "#exposure-out", "0.25 EV"),
            ("+", "#zoom-out", "1.07×"),
        ):
            page.keyboard.press(key)
            assert page.locator(output).inner_text() == shown, key
            count = settled(count)
        page.keyboard.press("]")
        page.keyboard.press("l")
        assert page.locator("#pose").input_value() == "1" and page.locator("#light").input_value() == "1"
        count = settled(count)
        page.keyboard.press("0")
        assert page.locator("#yaw-out").inner_text() == "0°" and page.locator("#light").input_value() == "0"
        count = settled(count)

        def slow(route: Any) -> None:
            answer = route.fetch()
            route.fulfill(response=answer, headers={**answer.headers, "x-milliseconds": "400"})

        page.route("**/picture?*", slow)
        asked: list[int] = []
        page.on("request", lambda request: asked.extend(map(int, re.findall(r"picture.*draft=(\d)", request.url))))
        for _ in range(10):  # the first whole pictures tell that they are slow, then drafts are asked for
            if 1 in asked:
                break
            page.keyboard.press("ArrowRight")
            count = settled(count)
        assert 1 in asked
        whole = "() => [...document.querySelectorAll('canvas')].every((c) => c.dataset.draft === '0')"
        for _ in range(600):  # at rest whole pictures take their place
            if asked[-1] == 0 and page.evaluate(whole):
                break
            page.wait_for_timeout(50)
        assert page.evaluate(whole) and page.locator("canvas").first.evaluate("c => c.width") == 48
        assert page.locator("#error").is_hidden() and not troubles, troubles
        browser.close()
