"""Workbench page in a headless browser: a user's workflow by mouse and keyboard."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from palpate.estimation.study.saved_diagnosis import RESULT
from tests.palpate.planted import install_program, planted_modules
from tests.palpate.presses import write_presses
from tests.palpate.workbench.test_foreign_texts import HOSTILE, MARK, forged, hostile, keep_diagnosis

CHROMIUM = Path("/usr/bin/chromium")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [
    pytest.mark.skipif(not CHROMIUM.exists(), reason=f"no {CHROMIUM} (apt-get install chromium)"),
    pytest.mark.slow,
]
WAIT_MS = 60_000  # a busy machine is no failure


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def serve(tmp_path, tmp_path_factory):
    """Starts the command in a folder of its own; gives the address."""
    started, program = [], install_program(tmp_path_factory.mktemp("installed"))

    def begin(*arguments):
        command = [sys.executable, program, "workbench", *map(str, arguments), "--port", "0", "--no-browser"]
        paths = {"PYTHONPATH": str(Path(__file__).parents[3]), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
        process = subprocess.Popen(command, cwd=tmp_path, env=paths, stdout=subprocess.PIPE, text=True)
        started.append(process)
        address = re.search(r"http://127\.0\.0\.1:(\d+)", process.stdout.readline())
        while socket.socket().connect_ex(("127.0.0.1", int(address[1]))):
            assert process.poll() is None
            time.sleep(0.1)
        return address[0]

    yield begin
    for process in started:
        process.send_signal(signal.SIGINT)
        assert process.wait(WAIT_MS / 100) in {0, 130}


class Tab:
    """One tab that notes what it should never see."""

    def __init__(self, browser, address, width=1400, height=900):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(WAIT_MS)
        self.wrong = []
        self.page.on(
            "console", lambda message: self.wrong.append(message.text) if message.type == "error" else None
        )
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("request", lambda request: self._check(request.url, address))
        self.page.on("websocket", lambda socket: self._check(socket.url.replace("ws:", "http:"), address))
        self.page.goto(address)

    def _check(self, url, address):
        if not url.startswith((address, "data:", "blob:")):
            self.wrong.append(f"request to {url}")

    def error(self):
        return float(self.page.wait_for_selector("[data-error]").get_attribute("data-error"))

    def wait_for_other_error(self, than):
        """Of the fit, after whatever a first look shows."""
        fitted = "document.querySelector('[data-error]:not([data-rough])')"
        self.page.wait_for_function(f"than => +({fitted}?.dataset.error ?? than) !== than", arg=than)
        return self.error()

    def box(self, effect):
        return self.page.wait_for_selector(f'[data-effect="{effect}"] .q-checkbox')


@pytest.fixture
def opened(browser, serve):
    """Opens tabs on what the command is started with; at the end none has seen what it should not."""
    tabs = []

    def begin(*arguments, address=None, **options):
        tabs.append(Tab(browser, address or serve(*arguments), **options))
        return tabs[-1]

    yield begin
    assert not [wrong for tab in tabs for wrong in tab.wrong]


@pytest.fixture
def press(tmp_path):
    return write_presses(tmp_path / "press.csv")


def test_adding_lowers_the_error_and_undo_keep_and_report_work(opened, press):
    tab = opened(press)
    before = tab.error()
    tab.box("cubic_stiffness").click()
    after = tab.wait_for_other_error(before)
    assert after < 0.3 * before
    page = tab.page
    page.wait_for_selector("text=/± [0-9]/")  # intervals
    page.wait_for_selector(".error .fits")
    curves = "() => document.querySelectorAll('.js-plotly-plot')[0].data.map(t => t.y.length)"
    assert all(0 < points < 2000 for points in page.evaluate(curves))
    assert "palpate add press.csv cubic_stiffness" in page.inner_text(".same")
    page.click("text=Undo")
    assert tab.wait_for_other_error(after) == before
    page.click("text=Redo")
    assert tab.wait_for_other_error(before) == after
    page.click("button:has-text('Report')")
    with page.expect_popup() as opened_report:
        page.click("a:has-text('report.html')")
    opened_report.value.wait_for_selector("text=cubic_stiffness")
    assert opened_report.value.evaluate("origin") == "null"  # it cannot reach the page's own origin
    report = press.parent / "press-palpate" / "report.html"
    assert "cubic_stiffness" in report.read_text()
    page.wait_for_selector(".revision:has-text('cubic_stiffness')")
    written = report.stat().st_mtime_ns
    page.click("button:has-text('Report')")  # what is kept is not kept again
    while report.stat().st_mtime_ns == written:
        page.wait_for_timeout(100)
    page.wait_for_timeout(1000)  # for the list of revisions to be drawn again
    assert page.locator(".revision:has-text('cubic_stiffness')").count() == 1


def test_keyboard_alone_suffices(opened, press):
    tab = opened(press)
    before, keys = tab.error(), tab.page.keyboard
    tab.box("cubic_stiffness")
    focused = "() => document.activeElement.closest('[data-effect]')?.dataset.effect ?? ''"
    for _ in range(200):
        keys.press("Tab")
        if tab.page.evaluate(focused) == "cubic_stiffness":
            break
    keys.press("Space")
    after = tab.wait_for_other_error(before)
    assert after < before
    keys.press("Control+z")
    assert tab.wait_for_other_error(after) == before
    keys.press("Control+y")
    assert tab.wait_for_other_error(before) == after


def test_every_view_follows_a_slider_and_undo_reverts_it(opened, press):
    tab = opened(press)
    page, before = tab.page, tab.error()
    tab.box("cubic_stiffness").click()
    after = tab.wait_for_other_error(before)
    page.wait_for_selector("text=/± [0-9]/")
    page.fill('[aria-label="A [s]"]', "0.9")
    page.wait_for_selector(".reading:has-text('model')")
    page.wait_for_function("() => document.querySelectorAll('.middle div.plot').length === 3")
    model = (
        "n => JSON.stringify("
        "document.querySelectorAll('.middle div.plot')[n].data?.[1]?.[n === 2 ? 'z' : 'y'] ?? '')"
    )
    for number in (1, 2):  # a plot is drawn when it is seen
        page.locator(".middle div.plot").nth(number).scroll_into_view_if_needed()
        page.wait_for_function(f"n => ({model})(n) !== '\"\"'", arg=number)
    drawn = [page.evaluate(model, number) for number in (1, 2)]
    reading = page.inner_text(".reading")
    interval = page.inner_text('[data-parameter="stiffness.k"] .interval')
    page.focus('[aria-label="stiffness.k"] [tabindex="0"]')
    page.keyboard.press("PageUp")
    pulled = tab.wait_for_other_error(after)
    assert pulled > after
    for number, earlier in zip((1, 2), drawn, strict=True):
        page.locator(".middle div.plot").nth(number).scroll_into_view_if_needed()
        page.wait_for_function(f"([n, earlier]) => ({model})(n) !== earlier", arg=[number, earlier])
    shown = page.inner_text(".reading")
    assert shown != reading
    force, predicted = (float(text.split()[1]) for text in shown.replace("A", "force").split(", ")[:2])
    at_cursor = (
        "() => { const [, , m] = document.querySelector('.middle div.plot').data; "
        "const i = m.x.findIndex(t => t >= 0.9); return m.y[i] }"
    )
    assert predicted == pytest.approx(page.evaluate(at_cursor), rel=0.01)
    assert force == pytest.approx(6.0, rel=0.05)
    assert page.inner_text('[data-parameter="stiffness.k"] .interval').startswith("fit: ")
    page.keyboard.press("Control+z")
    assert tab.wait_for_other_error(pulled) == after
    assert tab.box("cubic_stiffness").get_attribute("aria-checked") == "true"
    page.wait_for_function(
        "text => document.querySelector('[data-parameter=\"stiffness.k\"] .interval').innerText === text",
        arg=interval,
    )
    assert page.inner_text(".reading").split(", left")[0] == reading.split(", left")[0]


def test_diagnosis_survives_a_reload_can_be_stopped_and_applied(opened, press):
    tab = opened(press)
    before, page = tab.error(), tab.page
    page.click("button:has-text('Diagnose')")
    page.wait_for_selector("button:has-text('Stop')")
    page.reload()
    page.click("button:has-text('Stop')")
    page.wait_for_selector("text=nothing was changed")
    page.click("button:has-text('Diagnose')")
    page.wait_for_selector("button:has-text('Stop')")
    page.reload()
    page.wait_for_selector(".verdict.missing")
    page.click("button:has-text('Add cubic_stiffness')")
    after = tab.wait_for_other_error(before)
    assert after < before
    page.wait_for_function("() => !document.querySelector('.steps button')")  # it is ticked
    tab.box("cubic_stiffness").click()
    assert tab.wait_for_other_error(after) == before
    page.wait_for_selector("button:has-text('Add cubic_stiffness')")


def test_runs_are_held_out_by_choice(opened, press):
    tab = opened(press)
    before, page = tab.error(), tab.page
    page.click('[aria-label="runs to hold out"]')
    page.click('.q-menu .q-item:has-text("run 2")')
    page.keyboard.press("Escape")
    page.wait_for_selector(".same:has-text('--held-out 2')")
    assert tab.error() != before


def test_narrow_window_has_no_sideways_scroll(opened, press):
    tab = opened(press, width=400)
    before = tab.error()
    tab.page.wait_for_function("() => document.documentElement.scrollWidth <= 400")
    is_cut = "labels => labels.some(label => label.scrollWidth > label.clientWidth)"
    assert not tab.page.locator(".q-field__label").evaluate_all(is_cut)
    curves, checks = (tab.page.locator(name).first.bounding_box() for name in (".middle h2", ".gates"))
    assert curves["y"] < checks["y"]
    tab.box("cubic_stiffness").click()
    assert tab.wait_for_other_error(before) < before
    tab.page.set_viewport_size({"width": 1024, "height": 768})
    tops = "() => new Set([...document.querySelectorAll('.top .q-btn')].map(e => e.offsetTop)).size"
    tab.page.wait_for_function(f"() => ({tops})() === 1")
    for width in (844, 400):  # a phone is turned: unseen plots follow once they are seen
        tab.page.set_viewport_size({"width": width, "height": 844})
        tab.page.wait_for_function("width => document.documentElement.scrollWidth <= width", arg=width)
        for number in range(3):
            plot = tab.page.locator(".middle div.plot").nth(number)
            plot.scroll_into_view_if_needed()
            plot.locator(".main-svg").first.wait_for()
            tab.page.wait_for_function(
                "p => p.querySelector('.main-svg').clientWidth === p.clientWidth", arg=plot.element_handle()
            )


@pytest.mark.parametrize(("width", "height"), [(1280, 900), (1024, 768), (390, 844)])
def test_error_stays_visible_and_nothing_overlaps(opened, press, width, height):
    tab = opened(press, width=width, height=height)
    page = tab.page
    tab.error()
    page.wait_for_function("() => document.querySelectorAll('.middle div.plot').length === 3")
    page.locator(".middle div.plot").nth(2).scroll_into_view_if_needed()
    page.wait_for_selector(".annotation-text")
    page.mouse.wheel(0, 20_000)
    page.wait_for_timeout(300)
    assert page.evaluate("scrollY") > 300
    box = page.query_selector("[data-error]").bounding_box()
    assert 0 <= box["y"] < 100
    assert box["x"] + box["width"] <= width
    assert page.is_visible("text=base model kelvin_voigt") is (width > 760)
    texts = (
        "() => [...document.querySelectorAll('.middle div.plot')].map(plot => "
        "[...plot.querySelectorAll('.annotation-text, .xtitle, .x2title, .xtick text, .x2tick text')]"
        ".map(text => { const b = text.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom] }))"
    )
    for number in range(3):
        page.locator(".middle div.plot").nth(number).scroll_into_view_if_needed()
    page.wait_for_timeout(300)
    for boxes in page.evaluate(texts):
        for place, (left, top, right, bottom) in enumerate(boxes):
            for other in boxes[:place]:
                assert (
                    min(right, other[2]) - max(left, other[0]) < 1
                    or min(bottom, other[3]) - max(top, other[1]) < 3
                )


def choose_unit(page, column, unit):
    """Choose the unit of a column in the form for the columns of a file."""
    page.get_by_label(f"unit of {column}").locator("xpath=ancestor::label").click()
    page.get_by_role("option", name=unit, exact=True).click()


def test_dropped_file_is_shown_corrected_and_judged(opened, tmp_path, press):
    other = tmp_path / "odd" / "odd.csv"
    other.parent.mkdir()
    other.write_text(
        press.read_text().replace("time_s,displacement_m,force_N,run", "t [s],depth,Fz title=x [N],trial")
    )
    tab = opened()
    page = tab.page
    page.set_input_files("input[type=file]", other)
    page.wait_for_selector("text=is this right?")
    assert "depth" in page.inner_text(".dropped")
    page.click("text=Use these columns")
    page.wait_for_selector("text=column 'depth' states no unit")
    choose_unit(page, "depth", "m")
    page.click("text=Use these columns")
    assert tab.error() > 0.0
    assert "--column displacement=depth" in page.inner_text(".same")
    page.wait_for_selector("text=the sensor is not saturated")


def test_running_probe_is_displayed_live(opened, tmp_path):
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    tab = opened(sessions)
    tab.page.click("text=Probe the simulated arm")
    tab.page.wait_for_selector("text=palpate probe")
    assert tab.page.is_disabled("button:has-text('Probe the simulated arm')")
    assert tab.error() > 0.0  # the session that came back is open
    assert [file.name for file in sessions.glob("*.mcap")] == ["workbench-1.mcap"]
    tab.page.click(".channel")
    tab.page.click(".q-item:has-text('joint 2')")
    tab.page.wait_for_selector("text=base model rigid_body")
    tab.box("gravity_tilt").click()
    tab.page.wait_for_selector("text=+ gravity_tilt")
    tab.page.click('[data-effect="payload"] .picture:has-text("about")')  # needs an arm: has no picture
    tab.page.wait_for_selector(".gallery:has-text('payload')")


def test_files_next_to_a_recording_are_not_executed(opened, tmp_path, tmp_path_factory, press):
    """Neither by what fits ahead, nor by the diagnosis, nor by a probing."""
    with planted_modules(tmp_path, tmp_path_factory.mktemp("mark") / "executed"):
        tab = opened(press)
        tab.page.wait_for_selector('[data-effect="cubic_stiffness"] .evidence .strong')
        tab.page.click("button:has-text('Diagnose')")
        tab.page.wait_for_selector(".verdict.missing")
        tab.page.click("button:has-text('Open')")
        tab.page.click("text=Probe the simulated arm")
        tab.page.wait_for_selector(".file:has-text('workbench-1.mcap')")


def test_texts_of_a_foreign_diagnosis_are_shown_and_run_nothing(opened, press):
    """A quote in a text would end the text of a property, and begin one that the browser evaluates."""
    folder = press.parent / "press-palpate"
    folder.mkdir()
    keep_diagnosis(press, folder)
    kept = folder / RESULT
    kept.write_text(json.dumps(forged(hostile(json.loads(kept.read_text())))))
    page = opened(press).page
    page.wait_for_selector(f"text=Next: instruction: {MARK}")
    page.wait_for_selector(".gates .good")  # all is drawn
    assert page.evaluate(f"() => typeof globalThis.{MARK}") == "undefined"
    said = page.locator(f"text=Next: instruction: {MARK}").text_content()
    assert said == f"Next: instruction: {HOSTILE}, to purpose: {HOSTILE}"
    assert page.locator("img[src=x]").count() == 0
