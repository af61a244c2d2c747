"""A real browser for the pages: Debian's chromium, driven by Playwright."""

import os
import shutil

import pytest

_OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
)
PHONE_PX, DESK_PX = 420, 1400


@pytest.fixture(scope="session")
def browser():
    """A browser without a window; where there is none, the test is skipped."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        if os.environ.get("CI"):  # .ci/run installs it: a page that nobody opened is no page
            pytest.fail("there is no chromium, which .ci/run installs")
        pytest.skip("there is no chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=_OPTIONS)
        yield opened
        opened.close()


@pytest.fixture
def faults_of(browser):
    """A function that opens a page on a phone and a desk, light and dark, and lists its faults."""

    def faults(path):
        found = []
        for width, scheme in ((PHONE_PX, "light"), (PHONE_PX, "dark"), (DESK_PX, "light")):
            context = browser.new_context(
                viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True
            )
            tab = context.new_page()
            said = []
            tab.on("console", lambda message, said=said: said.append(message.text))
            tab.on("pageerror", lambda error, said=said: said.append(str(error)))
            tab.on("requestfailed", lambda request, said=said: said.append(request.url[:80]))
            tab.goto(path.resolve().as_uri())
            tab.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
            broken = tab.evaluate(
                "[...document.images].filter(i => !(i.complete && i.naturalWidth && i.alt)).length"
            )
            wide = tab.evaluate("document.documentElement.scrollWidth")
            lost = tab.evaluate(
                "[...document.querySelectorAll('a[href^=\"#\"]')]"
                ".map(a => a.getAttribute('href').slice(1))"
                ".filter(id => !document.getElementById(id))"
            )
            links = tab.evaluate(
                "[...document.querySelectorAll('a')].map(a => a.getAttribute('href'))"
                ".filter(h => !h.startsWith('#') && !h.startsWith('https://'))"
            )
            ground, letters = (
                tab.evaluate(f"getComputedStyle(document.body).{name}")
                for name in ("backgroundColor", "color")
            )
            context.close()
            where = f"{path.name} at {width} px, {scheme}"
            found += [f"{where}: {text}" for text in said]
            found += [f"{where}: {broken} pictures are missing or have no words"] * bool(broken)
            found += [f"{where}: {wide} px wide"] * (wide > width)
            found += [f"{where}: #{each} leads nowhere" for each in lost]
            found += [f"{where}: {each} is no file" for each in links if not _is_file(path, each)]
            found += [f"{where}: {letters} on {ground}"] * (
                (_brightness(ground) < _brightness(letters)) != (scheme == "dark")
            )
        return found

    return faults


def _is_file(page, link):
    from urllib.parse import unquote

    return (page.parent / unquote(link.partition("#")[0])).exists()


def _brightness(colour):
    """Sum of the channels of "rgb(1, 2, 3)"."""
    return sum(float(part) for part in colour.strip("rgba()").split(",")[:3])
