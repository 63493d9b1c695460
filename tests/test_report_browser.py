"""The report in a browser: loads alone and without errors, sorts, filters, and answers."""

import json
import os
import shutil

import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="there is no Chromium with chromedriver on this machine"
)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@pytest.fixture(scope="module")
def report(tmp_path_factory, small_study):
    """Return a report, alone in a folder as a co-author gets it."""
    return shutil.copy(small_study.report, tmp_path_factory.mktemp("alone") / "report.html")


@pytest.fixture(scope="module")
def browser(report, tmp_path_factory):
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = BROWSER
    profile = tmp_path_factory.mktemp("profile")
    for flag in (*FLAGS, f"--user-data-dir={profile}", "--window-size=1400,1000"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER, log_output=os.devnull))
    try:
        yield driver
    finally:
        driver.quit()


@pytest.fixture
def page(browser, report):
    browser.get(report.as_uri())
    return browser


def found(page, selector):
    return page.find_elements("css selector", selector)


def hover(page, element):
    page.execute_script(
        "arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", element
    )
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(page).move_to_element(element).perform()


def test_loads_alone_and_without_errors(page, report):
    assert page.title.startswith("mibvh study: cornell@3000, hairball@3000")
    assert page.get_log("browser") == []
    asked = [
        message["params"]["request"]["url"]
        for entry in page.get_log("performance")
        if (message := json.loads(entry["message"])["message"])["method"]
        == "Network.requestWillBeSent"
        and message["params"]["documentURL"] == report.as_uri()
    ]
    assert [url for url in asked if not url.startswith("data:")] == [report.as_uri()]
    pictures = "return [...document.images].every(i => i.complete && i.naturalWidth > 0)"
    assert page.execute_script(pictures)


def test_sorts(page):
    name = "#table-cornell\\@3000-trees"
    heads = [h.text.strip() for h in found(page, f"{name} th")]
    column = heads.index("SAH")
    button = found(page, f"{name} th button")[column]

    def values():
        return [
            float(row.find_elements("tag name", "td")[column].get_attribute("data-sort"))
            for row in found(page, f"{name} tbody tr")
        ]

    before = values()
    assert before != sorted(before)  # or sorting would prove nothing
    page.execute_script("arguments[0].click()", button)
    assert values() == sorted(before)
    page.execute_script("arguments[0].click()", button)
    assert values() == sorted(before, reverse=True)
    assert found(page, f"{name} th")[column].get_attribute("aria-sort") == "descending"


def test_filters(page):
    def shown(selector):
        return [e for e in found(page, selector) if e.is_displayed()]

    assert len(shown("section.scene")) == 2
    found(page, "#filter")[0].send_keys("HAIR")
    assert [s.get_attribute("data-name") for s in shown("section.scene")] == ["hairball@3000"]
    rows = len(shown("section.scene tr[data-builder=lbvh]"))
    assert rows == 1
    page.execute_script("document.querySelector('.chips input[value=lbvh]').click()")
    assert shown("section.scene [data-builder=lbvh]") == []
    assert len(shown("section.scene tr[data-builder=bbvh]")) == 1
    details = found(page, "#scene-hairball\\@3000 details.long")[-1]
    page.execute_script("arguments[0].open = true", details)
    details.find_element("css selector", ".filter-rows").send_keys("finite rays")
    kept = [r for r in details.find_elements("css selector", "tbody tr") if r.is_displayed()]
    assert len(kept) == 4  # one per measurement
    assert all("finite rays" in row.text for row in kept)


def test_tooltips_answer_to_mouse_and_keyboard(page):
    tip = found(page, "#tip")[0]
    assert not tip.is_displayed()
    point = found(page, "#scene-cornell\\@3000 .point[data-builder=hill]")[0]
    hover(page, point)
    assert tip.is_displayed()
    assert tip.text.startswith("hill: counted cost ")
    lit = found(page, "#scene-cornell\\@3000 tr.lit")
    assert [row.get_attribute("data-builder") for row in lit] == ["hill"] * 2  # two tables
    hover(page, found(page, "h1")[0])
    assert not tip.is_displayed()

    page.execute_script("document.querySelectorAll('details').forEach(d => { d.open = true })")
    term = found(page, ".term")[0]
    page.execute_script("arguments[0].focus()", term)
    assert tip.is_displayed()
    assert tip.text == term.get_attribute("data-tip")
    from selenium.webdriver.common.keys import Keys

    term.send_keys(Keys.TAB)
    assert tip.text != term.get_attribute("data-tip") or not tip.is_displayed()


@pytest.mark.parametrize("width", [400, 1400, 1800])
def test_no_page_is_wider_than_its_window(page, width):
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False},
    )
    try:
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_paper_shows_formulas_and_tables_and_then_folds_them_again(page):
    """Of what is folded only that is printed which stands nowhere else."""
    state = "return [...document.querySelectorAll('details.long')].map(d => [d.open, d.className])"
    assert not any(opened for opened, _ in page.execute_script(state))
    page.execute_script("dispatchEvent(new Event('beforeprint'))")
    after = page.execute_script(state)
    assert {opened for opened, name in after if "paper" in name} == {True}
    assert {opened for opened, name in after if "paper" not in name} == {False}
    cards = [e for e in found(page, ".card code") if e.is_displayed()]
    assert len(cards) == len(found(page, ".card"))
    page.execute_script("dispatchEvent(new Event('afterprint'))")
    assert not any(opened for opened, _ in page.execute_script(state))
