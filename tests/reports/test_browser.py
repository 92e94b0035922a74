"""The page in headless Chromium, opened from disk: no network, by mouse, keyboard and touch, on a phone, in print."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handbench.reports.build import build
from handbench.reports.page import PageContent, render_page
from handbench.reports.pareto import plots
from handbench.reports.run import Run, read_run
from handbench.reports.viewer import viewer
from handbench.results.recordfile import sealed
from handbench.scene.colour import linear

sync_api = pytest.importorskip("playwright.sync_api", reason="the Python package playwright is not installed")

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next((found for name in NAMES if (found := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason=f"no Chromium is installed: none of {', '.join(NAMES)} is there"
)
QUIET = ("no-sandbox", "disable-gpu", "disable-background-networking", "no-first-run", "disable-component-update")
SPARING = ("renderer-process-limit=1",)  # windows share a process
TOLERATED = 1  # pixels of rounding
A4 = (1032, 700)  # pixels across, less its margins


@pytest.fixture(scope="module")
def run(whole_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a published row, and a method without any value."""
    folder = tmp_path_factory.mktemp("browser") / "run"
    shutil.copytree(whole_run, folder, ignore=shutil.ignore_patterns("report"))
    plan = json.loads((folder / "run.json").read_text())
    told = {"method": "urhand", "title": "URHand", "marker": "†", "source": "A paper"}
    plan["protocol"]["published"] = [{**told, "values": {"unseen-segment": [29.5, None, None]}}]
    plan["protocol"]["published_note"] = ""
    (folder / "run.json").write_text(json.dumps(sealed(plan) if "digest" in plan else plan))
    for cell in read_run(folder).of_method("physical"):
        (folder / "cells" / f"{cell.key}.json").unlink()
    return folder


@pytest.fixture(scope="module")
def address(run: Path, page_of: Callable[[Path], str]) -> str:
    path = run / "page.html"
    path.write_text(page_of(run), encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def wide_address(many: Run, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of 15 methods in six columns of four metrics, without pictures, with the plots that show at first."""
    path, rows = tmp_path_factory.mktemp("many") / "page.html", build(many)
    shown = PageContent((), (), plots(rows)[: len(rows.groups)], viewer(many, rows))
    path.write_text(render_page(rows, many, shown), encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        flags = [f"--{flag}" for flag in (*QUIET, *SPARING, "disable-sync")]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


class Opened:
    """The page in a window, and what it complained of or asked the network for."""

    def __init__(self, browser: Any, width: int = 1280, height: int = 900, **settings: Any) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": height}, **settings)
        self.page = self.context.new_page()
        self.page.set_default_timeout(120_000)  # a machine may be busy
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.scripts = settings.get("java_script_enabled", True)

    def show(self, address: str) -> Opened:
        """Load the page, as it is before anybody touches it."""
        self.page.mouse.move(0, 0)
        self.complaints.clear()
        self.requests.clear()
        self.page.goto(address)
        if self.scripts and self.page.locator(".stage").count():
            self.drawn()
        return self

    def become(self, width: int = 1280, height: int = 900, media: str = "screen", scheme: str = "light") -> Opened:
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.emulate_media(media=media, color_scheme=scheme)
        return self

    def drawn(self) -> None:
        self.page.wait_for_selector('.stage[aria-busy="false"]')

    def choose(self, name: str, value: str) -> None:
        self.page.select_option(f'.viewer select[name="{name}"]', value)
        self.drawn()

    def pictures(self) -> list[str]:
        return self.page.eval_on_selector_all(".side canvas", "all => all.map(one => one.toDataURL())")

    def style(self, selector: str, name: str) -> str:
        return self.page.eval_on_selector(selector, f"one => getComputedStyle(one).getPropertyValue('{name}')")

    def view(self) -> tuple[float, float, float]:
        """Zoom, and the shift to the right and down as shares of the stage."""
        transform = self.page.eval_on_selector(".side.left canvas", "one => one.style.transform")
        x, y, zoom = map(float, re.findall(r"[-\d.]+(?:e-?\d+)?", transform))
        return zoom, x / 100, y / 100

    def split(self) -> float:
        return float(self.style(".stage", "--split"))

    def middle(self) -> tuple[float, float]:
        self.page.locator(".stage").scroll_into_view_if_needed()
        box = self.page.locator(".stage").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.fixture(scope="module")
def window(browser: Any) -> Opened:
    """One for most tests: a new window takes as much time as two pages."""
    return Opened(browser)


@pytest.fixture
def opened(window: Opened, address: str) -> Iterator[Opened]:
    """The page, loaded for this test."""
    yield window.become().show(address)
    assert not window.complaints, "nothing that a test does makes the page complain"


@pytest.fixture(scope="module")
def loaded(browser: Any, address: str) -> Opened:
    return Opened(browser).show(address)


@pytest.fixture
def seen(loaded: Opened) -> Iterator[Opened]:
    """The page, loaded once: to be looked at, in windows of other widths too, not to be touched."""
    yield loaded.become()
    assert not loaded.complaints


@pytest.fixture(scope="module")
def wide(browser: Any, wide_address: str) -> Opened:
    """The wide page, to be looked at in windows of all widths."""
    return Opened(browser, 390, 900).show(wide_address)


def test_the_page_opens_from_disk_and_asks_the_network_for_nothing(seen: Opened) -> None:
    assert seen.page.title().startswith("Quick comparison")
    assert not [url for url in seen.requests if not url.startswith(("file:", "data:"))]
    broken = "all => all.filter(one => one.complete && !one.naturalWidth).length"
    assert seen.page.eval_on_selector_all("img", broken) == 0


def test_links_of_the_contents_lead_to_sections(seen: Opened) -> None:
    links = seen.page.eval_on_selector_all(".contents a", "all => all.map(one => one.getAttribute('href'))")
    assert {"#results", "#methods", "#pareto", "#viewer", "#figures"} <= set(links)
    assert all(seen.page.locator(link).count() == 1 for link in links)


def test_sorting_goes_both_ways_keeps_gaps_and_published_rows_last_and_is_announced(opened: Opened) -> None:
    page = opened.page
    body, head = ".overview tbody tr", page.locator(".overview thead button").nth(1)  # PSNR of the first column
    first = "all => all.map(row => row.className + ' ' + row.cells[0].dataset.value)"
    head.focus()
    page.keyboard.press("Enter")
    ordered = page.eval_on_selector_all(body, first)
    values = ["calibration Oracle", "method URHand", "method Phong", "calibration Mean"]
    last = ["method Physical_BRDF & fit", "published URHand"]
    assert ordered == values + last
    assert page.locator(".results th[aria-sort]").get_attribute("aria-sort") == "descending"
    assert page.inner_text("#said") == "Sorted by Unseen segment 3 subjects, 24 frames, descending"
    page.keyboard.press("Enter")
    assert page.eval_on_selector_all(body, first) == values[::-1] + last


def test_plots_follow_the_choice_of_metric_and_time(opened: Opened) -> None:
    page = opened.page
    assert page.locator("#pareto-plots figure:visible").count() == 3
    page.click('.choices [data-metric="ssim"]')
    page.click('.choices [data-time="training"]')
    titles = page.locator("#pareto-plots figure:visible svg > title")
    assert [text.split(":")[0] for text in titles.all_text_contents()] == [
        "SSIM against time, training and one personalisation"
    ] * 3
    assert page.locator('.choices [aria-pressed="true"]').all_inner_texts() == [
        "SSIM",
        "Training and one personalisation",
    ]


def test_labels_in_plots_do_not_overlap_in_the_browsers_own_font(seen: Opened) -> None:
    boxes = """all => all.map(one =>
      [...one.querySelectorAll("g text")].map(text => text.getBoundingClientRect().toJSON()))"""
    for labels in seen.page.eval_on_selector_all("#pareto-plots figure:not([hidden]) svg", boxes):
        for i, one in enumerate(labels):
            for other in labels[:i]:
                across = min(one["right"], other["right"]) - max(one["left"], other["left"])
                down = min(one["bottom"], other["bottom"]) - max(one["top"], other["top"])
                assert across < 1 or down < 4, (one, other)  # a line of text is taller than its letters


def test_the_divider_moves_by_keyboard_and_by_mouse(opened: Opened) -> None:
    page = opened.page
    page.focus(".split")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    assert opened.split() == 55
    assert page.get_attribute(".split", "aria-valuetext") == "55 % Truth, 45 % URHand"
    page.keyboard.press("End")
    assert opened.split() == 100
    page.focus(".stage")
    page.keyboard.press("ArrowLeft")
    assert opened.split() == 98 and page.input_value(".split") == "98"
    x, y = opened.middle()
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 40, y)
    page.mouse.up()
    assert opened.split() < 50
    clip = opened.style(".side.right", "clip-path")
    assert float(re.findall(r"([\d.]+)%", clip)[-1]) == pytest.approx(opened.split(), abs=0.1)


def test_choosing_a_method_changes_its_side_its_score_and_what_is_said(opened: Opened, run: Path) -> None:
    page, before = opened.page, opened.pictures()
    page.select_option('select[name="right"]', label="Phong")
    opened.drawn()
    after = opened.pictures()
    assert after[0] == before[0] and after[1] != before[1]
    values = {name: page.input_value(f'select[name="{name}"]') for name in ("subject", "pose", "camera", "light")}
    frames = [frame for cell in read_run(run).of_method("phong") for frame in cell.scores]
    told = next(frame.values for frame in frames if frame.query == "/".join(values.values()))
    shown = page.locator(".scores td.right").all_inner_texts()
    assert shown == [f"{told[0]:.2f} dB", f"{told[1]:.3f}", f"{told[2]:.3f}"]
    assert page.inner_text(".said") == f"Left: Truth; right: Phong, PSNR {shown[0]}."
    assert page.get_attribute(".side.right canvas", "aria-label") == f"Phong, PSNR {shown[0]}"
    page.click(".swap")
    opened.drawn()
    assert opened.pictures() == after[::-1]


def test_the_four_choices_reach_every_frame_and_keep_what_they_can(opened: Opened) -> None:
    page, before = opened.page, opened.pictures()
    opened.choose("subject", "s02")
    assert opened.pictures() != before
    opened.choose("pose", "open")
    opened.choose("camera", "palmar")
    opened.choose("light", "environment-07")
    opened.choose("subject", "s01")
    kept = [page.input_value(f'select[name="{name}"]') for name in ("subject", "pose", "camera", "light")]
    assert kept == ["s01", "open", "palmar", "environment-07"]
    assert page.eval_on_selector_all('select[name="light"] optgroup', "all => all.map(one => one.label)") == [
        "One light at a time",
        "Group of lights",
        "Environment map",
    ]
    opened.choose("column", "unseen-light")
    assert page.inner_text(".place") == "1 of 24" and page.input_value('select[name="light"]') == "olat-03"
    page.click(".before")
    opened.drawn()
    assert page.inner_text(".place") == "24 of 24" and "Unseen light" in page.inner_text(".exposure")


def test_a_missing_picture_is_told_in_its_place(opened: Opened) -> None:
    opened.page.select_option('select[name="right"]', label="Phong")
    opened.choose("column", "unseen-light")
    assert "non-finite: 3 pixels" in opened.page.inner_text(".side.right .missing")
    assert opened.page.locator(".scores td.right").all_inner_texts() == ["– dB", "–", "–"]


def test_the_error_map_is_zero_for_what_is_right_and_bright_where_a_method_is_wrong(opened: Opened) -> None:
    page = opened.page
    light = """all => all.map(one => {
      const copy = Object.assign(document.createElement("canvas"), { width: one.width, height: one.height });
      const context = copy.getContext("2d", { willReadFrequently: true });
      context.drawImage(one, 0, 0);
      const data = context.getImageData(0, 0, one.width, one.height).data;
      return [[...data.slice(0, 3)], data.reduce((sum, value, i) => sum + (i % 4 < 3 ? value : 0), 0) / data.length];
    })"""
    found = {}
    truth = opened.pictures()[0]
    page.check(".error")
    opened.drawn()
    assert opened.pictures()[0] == truth, "the truth has no error to show"
    for title in ("Mean", "URHand"):
        page.select_option('select[name="right"]', label=title)
        opened.drawn()
        corner, found[title] = page.eval_on_selector_all(".side canvas", light)[1]
        assert corner == [0, 0, 3], "the colour of no error, outside of the hand"
    assert found["Mean"] > 1.5 * found["URHand"] > 0
    assert page.is_visible(".viewer .legend") and page.inner_text(".tag.right") == "URHand, error"
    page.focus(".stage")
    page.keyboard.press("e")
    opened.drawn()
    assert not page.is_visible(".viewer .legend")


def test_zoom_by_buttons_keys_and_wheel_and_pan(opened: Opened) -> None:
    page = opened.page
    page.click(".tools .in")
    assert opened.view() == pytest.approx((1.5, -0.25, -0.25)) and page.inner_text(".zoom") == "1.5×"
    page.focus(".stage")
    page.keyboard.press("+")
    page.keyboard.press("+")
    assert opened.view()[0] == pytest.approx(1.5**3)
    before = opened.view()
    page.keyboard.press("ArrowRight")
    assert opened.view()[1] == pytest.approx(before[1] - 0.1) and opened.split() == 50, (
        "zoomed, arrows move the picture"
    )
    x, y = opened.middle()
    page.mouse.move(x + 60, y)
    page.mouse.down()
    page.mouse.move(x + 100, y + 30)
    page.mouse.up()
    assert opened.view()[1] > before[1] - 0.1 and opened.view()[2] > before[2] and opened.split() == 50
    page.keyboard.press("0")
    assert opened.view() == (1, 0, 0)
    page.mouse.wheel(0, -300)
    page.wait_for_function("document.querySelector('.zoom').value !== '1×'")
    zoom, left, _ = opened.view()
    assert zoom == pytest.approx(2.718, abs=0.01)
    box = page.locator(".stage").bounding_box()
    share = (x + 100 - box["x"]) / box["width"]
    assert (share - left) / zoom == pytest.approx(share, abs=0.01), "what is under the pointer stays there"
    page.click(".fit")
    assert opened.view() == (1, 0, 0)


def test_the_wheel_scrolls_the_page_until_the_picture_is_chosen(opened: Opened) -> None:
    x, y = opened.middle()
    opened.page.mouse.move(x, y)
    before = opened.page.evaluate("scrollY")
    opened.page.mouse.wheel(0, -200)  # what would zoom in
    opened.page.wait_for_function(f"scrollY < {before}")
    assert opened.view()[0] == 1


def test_by_touch_one_finger_moves_the_divider_and_two_zoom(browser: Any, address: str) -> None:
    opened = Opened(browser, 390, 780, has_touch=True, is_mobile=True).show(address)
    x, y = opened.middle()
    touch = opened.context.new_cdp_session(opened.page)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x + dx, "y": y + dy, "id": i} for i, (dx, dy) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", (0, 0))
    for dx in (10, 30, 60, 90):
        fingers("touchMove", (dx, 0))
    fingers("touchEnd")
    assert opened.split() > 60
    fingers("touchStart", (-20, 0), (20, 0))
    for dx in (25, 35, 50, 60):
        fingers("touchMove", (-dx, 0), (dx, 0))
    fingers("touchEnd")
    assert opened.view()[0] == pytest.approx(3, rel=0.15)
    assert opened.page.evaluate("visualViewport.scale") == 1, "the picture was zoomed, not the page"
    opened.context.close()


def test_the_overview_shows_one_metric_which_a_link_keeps(opened: Opened) -> None:
    page = opened.page
    page.click('.picker [data-metric="ssim"]')
    heads = page.locator(".overview thead th.num:visible")
    assert heads.count() == 3 and heads.first.inner_text().startswith("Unseen segment")
    assert page.inner_text(".overview .metric").replace("\xa0", " ") == "SSIM ↑"
    assert page.evaluate("location.hash") == "#metric=ssim"
    page.reload()
    opened.drawn()
    assert page.locator('.picker [aria-pressed="true"]').get_attribute("data-metric") == "ssim"
    published = page.locator(".overview tr.published:visible")
    assert published.count() == 0, "a row of dashes is not shown"
    page.click('.picker [data-metric="psnr"]')
    assert published.count() == 1
    assert page.evaluate("location.hash") in ("", "#")


def test_means_by_subject_and_by_light_are_those_of_the_scores(opened: Opened, run: Path) -> None:
    page = opened.page
    page.select_option('.breakdown [name="column"]', "unseen-light")
    found = [f.values[0] for c in read_run(run).of_method("urhand") for f in c.scores if f.column == "unseen-light"]
    cells = "all => all.map(one => [...one.cells].map(cell => cell.textContent))"
    by_subject = page.eval_on_selector_all(".means tbody tr", cells)
    assert [line[:2] for line in by_subject] == [["s01", "8"], ["s02", "8"], ["s03", "8"]]
    heads = page.eval_on_selector_all(".means thead th", "all => all.map(one => one.textContent)")
    mean = sum(float(line[heads.index("URHand")]) for line in by_subject) / 3
    assert mean == pytest.approx(sum(found) / len(found), abs=0.01)
    page.select_option('.breakdown [name="by"]', "light")
    assert [line[0] for line in page.eval_on_selector_all(".means tbody tr", cells)] == ["olat-03", "olat-07"]
    assert "by=light" in page.evaluate("location.hash") and "within=unseen-light" in page.evaluate("location.hash")


def test_frames_are_sorted_by_score_and_by_difference_and_lead_to_the_viewer(opened: Opened) -> None:
    page = opened.page
    numbers = "all => all.map(one => Number(one.cells[{}].textContent.replace('−', '-')))"
    worst = page.eval_on_selector_all(".frames tbody tr", numbers.format(1))
    assert worst == sorted(worst) and len(worst) == 12, "the worst of the best method first"
    page.select_option('.breakdown [name="beside"]', label="Mean")
    page.select_option('.breakdown [name="order"]', "loss")
    apart = page.eval_on_selector_all(".frames tbody tr", numbers.format(3))
    assert apart == sorted(apart)
    page.click("button.every")
    assert page.locator(".frames tbody tr").count() == 72
    query = page.inner_text(".frames tbody button >> nth=0")
    page.click(".frames tbody button >> nth=0")
    opened.drawn()
    parts = [page.input_value(f'.viewer [name="{name}"]') for name in ("subject", "pose", "camera", "light")]
    assert "/".join(parts) == query
    assert page.inner_text(".tag.left") == "Mean" and page.inner_text(".tag.right") == "URHand"


def test_a_link_keeps_frame_methods_error_and_exposure(opened: Opened) -> None:
    page = opened.page
    opened.choose("left", "3")
    page.check(".viewer .error")
    page.fill(".exposing", "-2")
    opened.drawn()
    before = page.inner_text(".place"), page.evaluate(PIXELS)
    kept = page.evaluate("location.hash")
    assert "left=urhand" in kept and "error=1" in kept and "stops=-2" in kept
    page.reload()
    opened.drawn()
    page.wait_for_function(f"location.hash === {json.dumps(kept)}")
    assert (page.inner_text(".place"), page.evaluate(PIXELS)) == before


PIXELS = """() => {
  const from = document.querySelector(".side.left canvas");
  const copy = new OffscreenCanvas(from.width, from.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(from, 0, 0);
  return [...copy.getImageData(20, 40, 9, 1).data];
}"""


def test_the_slider_changes_the_exposure_of_the_linear_picture(opened: Opened) -> None:
    """One stop less is half of the light, not half of the sRGB value."""
    page = opened.page
    once = np.array(page.evaluate(PIXELS), dtype=float).reshape(-1, 4)[:, :3] / 255
    page.fill(".exposing", "-1")
    page.wait_for_function("document.querySelector('.ev').value === '−1'")
    opened.drawn()
    half = np.array(page.evaluate(PIXELS), dtype=float).reshape(-1, 4)[:, :3] / 255
    shown = once > 0.2
    assert shown.any()
    assert linear(half[shown]) == pytest.approx(linear(once[shown]) / 2, abs=0.02)


def test_all_methods_are_side_by_side_and_a_frame_can_be_saved(opened: Opened) -> None:
    page = opened.page
    page.click(".all summary")
    page.wait_for_selector(".tiles canvas")
    told = page.eval_on_selector_all(".tiles button", "all => all.map(one => one.textContent)")
    assert [text.partition(" ")[0] for text in told] == ["Truth", "Mean", "Phong", "URHand"]
    page.click(".tiles button >> nth=1")
    opened.drawn()
    assert page.inner_text(".tag.right") == "Mean"
    with page.expect_download() as download:
        page.click(".save.right")
    assert re.fullmatch(r"s01__.*--mean\.png", download.value.suggested_filename)


WIDE = """() => [...document.querySelectorAll(".scroll")].filter(one => one.scrollWidth > one.clientWidth + 2)
  .map(one => [one.getAttribute("aria-label"), !one.previousElementSibling.hidden, one.dataset.more])"""


@pytest.mark.parametrize("width", (390, 820, 1280, 2560))
def test_no_column_is_off_screen_without_a_cue(wide: Opened, width: int) -> None:
    """24 value columns and 15 methods: tables fit, or say that they go on, and where."""
    page = wide.become(width).page
    page.evaluate("() => new Promise(done => requestAnimationFrame(done))")  # the page has heard of its width
    found = page.evaluate(WIDE)
    assert all(cue and more == "right" for _, cue, more in found), found
    if width >= 820:
        assert not [label for label, *_ in found if "metric" in label], "tables of results fit"
    assert page.evaluate("document.documentElement.scrollWidth") <= width + TOLERATED


def test_print_has_all_24_columns(wide: Opened) -> None:
    page = wide.become(*A4, media="print").page
    cut = "all => all.filter(one => one.getBoundingClientRect().right > innerWidth + 1).map(one => one.className)"
    assert page.eval_on_selector_all("table", cut) == []
    assert page.locator(".block th.num:visible").count() == 24


@pytest.mark.parametrize("width", (320, 400, 768))
def test_a_narrow_window_has_no_sideways_scroll(seen: Opened, width: int) -> None:
    page = seen.become(width, 700).page
    wide = """() => [...document.querySelectorAll("body *")].filter(one =>
      one.getBoundingClientRect().right > innerWidth + 1 && !one.closest(".scroll, .hidden, .side, .skip")
    ).map(one => one.outerHTML.slice(0, 90))"""
    assert page.evaluate("document.documentElement.scrollWidth") <= width + TOLERATED
    assert page.evaluate(wide) == []


def test_print_has_whole_tables_and_no_controls(opened: Opened) -> None:
    page = opened.become(*A4).page
    page.click(".picker button:nth-child(2)")
    opened.become(*A4, media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    for selector in (".picker", ".choices", "#viewer", ".contents"):
        assert not page.locator(selector).first.is_visible(), selector
    tables = "all => all.filter(one => one.getBoundingClientRect().right > innerWidth + 1).map(one => one.className)"
    assert page.eval_on_selector_all("table", tables) == []
    assert page.locator(".block:visible th.num").count() == 9, "all columns, though one metric was picked"
    assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")


@pytest.mark.parametrize("scheme", ("light", "dark"))
def test_text_has_contrast(seen: Opened, scheme: str) -> None:
    faint = """() => {
      const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
      const luminance = (rgb) => rgb.slice(0, 3).map((v) => v / 255)
        .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
      const behind = (one) => {
        for (; one; one = one.parentElement) {
          const found = numbers(getComputedStyle(one).backgroundColor);
          if (found.length === 3 || found[3] > 0.5) return found;
        }
      };
      const found = new Set();
      for (const one of document.querySelectorAll("body *")) {
        const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
        if (!own || !one.checkVisibility() || one.closest(".hidden, .skip, script, .side")) continue;
        const style = getComputedStyle(one);
        const text = numbers(one instanceof SVGElement ? style.fill : style.color);
        const pair = [luminance(text), luminance(behind(one))].sort((a, b) => b - a);
        const ratio = (pair[0] + 0.05) / (pair[1] + 0.05);
        if (ratio < 4.5) found.add(`${one.tagName}.${one.getAttribute("class")} ${ratio.toFixed(2)}`);
      }
      return [...found];
    }"""
    assert seen.become(scheme=scheme).page.evaluate(faint) == []


def test_everything_that_can_be_operated_has_a_name_and_a_visible_focus(opened: Opened) -> None:
    page = opened.page
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the results"
    nameless = """all => all.filter(one => one.checkVisibility() && !(
      one.getAttribute("aria-label") || (one.tagName !== "SELECT" && one.textContent.trim()) ||
      [...(one.labels ?? [])].some(label => label.textContent.trim())
    )).map(one => one.outerHTML)"""
    assert page.eval_on_selector_all("button, select, input, output, a", nameless) == []
    outlined = """() => {
      const style = getComputedStyle(document.activeElement);
      return style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 1;
    }"""
    visited = set()
    for _ in range(200):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement === document.body"):
            break
        visited.add(page.evaluate("document.activeElement.className || document.activeElement.name || ''"))
        assert page.evaluate(outlined), page.evaluate("document.activeElement.outerHTML.slice(0, 90)")
    assert {"stage", "split", "error", "swap", "subject", "right", "before"} <= visited, "the viewer is on the way"


def test_tables_have_captions_and_heads_have_scopes(seen: Opened) -> None:
    bare = "all => all.filter(one => !one.caption?.textContent.trim()).length"
    assert seen.page.eval_on_selector_all("table", bare) == 0
    assert seen.page.locator("th:not([scope])").count() == 0


def test_without_scripts_the_results_are_there_and_the_viewer_says_why_it_is_not(browser: Any, address: str) -> None:
    opened = Opened(browser, java_script_enabled=False).show(address)
    page = opened.page
    assert page.is_visible(".results") and not page.is_visible(".viewer") and not page.is_visible(".choices")
    assert "needs JavaScript" in page.inner_text("#viewer")
    assert page.locator("#pareto-plots figure:visible").count() == 27
    opened.context.close()
