"""The study in a real browser: Debian's Chromium, driven by Playwright."""

import shutil

import pytest

from .conftest import RATED, STUDY
from .served import Server

CHROMIUM = shutil.which("chromium")
playwright = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs the program chromium"),
]
PHONE = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    file = tmp_path_factory.mktemp("browser") / "study.yaml"
    file.write_text(STUDY.replace("participants: 5", "participants: 50"))
    with Server(file) as served:
        yield served


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture
def visit(browser, server):
    """Opens a page of a new person, who has agreed; fails if the page complains of anything."""
    opened, complaints = [], []

    def make(**settings):
        context = browser.new_context(**settings)
        opened.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(server.links["for people"])
        page.get_by_role("checkbox").check()
        page.get_by_role("button", name="Begin").click()
        page.wait_for_url("**/p/*")
        return page

    yield make
    for context in opened:
        context.close()
    assert [text for text in complaints if "404" not in text] == []


def say(page, text):
    page.get_by_label("Your message").fill(text)
    page.get_by_role("button", name="Send").click()
    page.wait_for_load_state()


def in_sight(page, selector):
    """Returns the pixels of an element's height that are on the screen."""
    box, height = page.locator(selector).bounding_box(), page.viewport_size["height"]
    return min(box["y"] + box["height"], height) - max(box["y"], 0)


def fits(page):
    return page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.parametrize("script", [True, False], ids=["with script", "without script"])
def test_on_a_phone_the_goal_is_small_once_read_and_the_rating_is_in_sight(visit, script):
    page = visit(**PHONE, java_script_enabled=script)
    assert in_sight(page, "details.card") > 100
    for number in range(8):
        say(page, f"message {number} {'W' * 300}")
    assert fits(page)
    page.get_by_label("Your message").focus()  # near the end of the page
    assert 20 < in_sight(page, "details.card") < 80
    assert in_sight(page, "#text") > 20
    page.locator("summary").tap()
    assert in_sight(page, "details.card") > 100
    say(page, "after it was opened")
    assert (in_sight(page, "details.card") > 100) == script  # which remembers it
    say(page, "bye")
    assert fits(page)
    assert in_sight(page, "fieldset >> nth=0") > 60
    for name in RATED:
        page.locator(f"input[name={name}]").first.check()
    page.get_by_role("button", name="Next").click()
    assert page.locator("details.card").get_attribute("open") is not None  # another goal
