"""A real browser for the pages: Debian's chromium, driven by Playwright."""

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
_WHAT_IS_SEEN = """() => {
    document.querySelectorAll('details').forEach(each => each.open = true);
    const style = getComputedStyle(document.body);
    const links = [...document.querySelectorAll('a')].map(each => each.getAttribute('href'));
    return {
        broken: [...document.images].filter(i => !(i.complete && i.naturalWidth && i.alt)).length,
        wide: document.documentElement.scrollWidth,
        lost: links.filter(h => h.startsWith('#') && !document.getElementById(h.slice(1)))
            .map(h => h.slice(1)),
        links: links.filter(h => !h.startsWith('#') && !h.startsWith('https://')),
        ground: style.backgroundColor,
        letters: style.color,
    };
}"""


@pytest.fixture(scope="session")
def browser():
    """A browser without a window; where there is none, the test is skipped."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=_OPTIONS)
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def tab(browser):
    """A tab that reaches no network, for all pages: to start one costs three pages."""
    context = browser.new_context(offline=True)
    yield context.new_page()
    context.close()


@pytest.fixture
def complaints(tab):
    """What a page in the tab complains of."""
    said = []
    listeners = {
        "console": lambda message: said.append(message.text),
        "pageerror": lambda error: said.append(str(error)),
        "requestfailed": lambda request: said.append(request.url[:80]),
    }
    for event, listener in listeners.items():
        tab.on(event, listener)
    yield said
    for event, listener in listeners.items():
        tab.remove_listener(event, listener)


@pytest.fixture
def faults_of(tab, complaints):
    """A function that opens a page on a phone and a desk, light and dark, and lists its faults."""

    def faults(path):
        complaints.clear()
        tab.set_viewport_size({"width": PHONE_PX, "height": 900})
        tab.goto(path.resolve().as_uri())
        screens = []
        for width, scheme in ((PHONE_PX, "light"), (PHONE_PX, "dark"), (DESK_PX, "light")):
            tab.set_viewport_size({"width": width, "height": 900})
            tab.emulate_media(color_scheme=scheme)
            screens.append((width, scheme, tab.evaluate(_WHAT_IS_SEEN)))
        found = [f"{path.name}: {text}" for text in complaints]
        for width, scheme, seen in screens:
            where = f"{path.name} at {width} px, {scheme}"
            ground, letters = seen["ground"], seen["letters"]
            broken, wide = seen["broken"], seen["wide"]
            found += [f"{where}: {broken} pictures are missing or have no words"] * bool(broken)
            found += [f"{where}: {wide} px wide"] * (wide > width)
            found += [f"{where}: #{each} leads nowhere" for each in seen["lost"]]
            found += [
                f"{where}: {each} is no file" for each in seen["links"] if not _is_file(path, each)
            ]
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
